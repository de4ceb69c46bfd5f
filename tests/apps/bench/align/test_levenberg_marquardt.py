"""Levenberg-Marquardt on alignment tasks: it solves them in few queries, each task as if it were alone."""

from __future__ import annotations

import numpy as np
import pytest

from alignment_errors import errors_at
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box
from grasp_refine_apps.bench.align.bodies import BodyPair, normalised
from grasp_refine_apps.bench.align.levenberg_marquardt import TOLERANCE_M2, run_levenberg_marquardt
from grasp_refine_apps.bench.align.patch import Patch
from grasp_refine_apps.bench.align.tasks import CLASSES, Tasks, draw_tasks
from grasp_refine_apps.bench.align.variants import Variant
from shapes_for_tests import cluster_body, convex_body, ring_body

PAIR = BodyPair("hulls", "convex", normalised(convex_body(1, 24), 0.06), normalised(convex_body(2, 24), 0.09))
CONCAVE = BodyPair("ring and cluster", "concave", normalised(ring_body(), 0.12), normalised(cluster_body(3, 4), 0.1))
BOXES = BodyPair("boxes", "convex", build_body("a", [box([0.04, 0.05, 0.06])]), build_body("b", [box([0.05] * 3)]))


def accepted(pair: BodyPair, count: int, classes: tuple[str, ...] = CLASSES[:3]) -> Tasks:
    tasks = draw_tasks(pair, classes, count, 0)
    return tasks.take(np.flatnonzero(tasks.accepted))


@pytest.mark.parametrize("margin", [0.0, 1e-3])
@pytest.mark.parametrize("pair", [PAIR, CONCAVE], ids=["convex", "concave"])
def test_it_solves_tasks_and_reports_how_many_queries_each_took(pair: BodyPair, margin: float):
    tasks = accepted(pair, 12)
    before = errors_at(pair, tasks, tasks.T_world_a, tasks.T_world_b, margin)
    result = run_levenberg_marquardt([pair], [tasks], Variant.least_squares(margin=margin, budget=200))
    assert (result.error[tasks.reachable, 0] < 1e-8).mean() >= 0.8
    assert (result.error[:, 0] <= before).all()
    np.testing.assert_array_equal(result.T_world_a[:, 0], tasks.T_world_a)
    found = errors_at(pair, tasks, tasks.T_world_a, result.T_world_b[:, 0], margin)
    np.testing.assert_allclose(result.error[:, 0], found, rtol=1e-6, atol=1e-18)
    assert ((result.iterations > 0) & (result.iterations <= 200)).all()
    # Whoever is not solved has used all that there was.
    solved = result.error < 2 * TOLERANCE_M2
    assert (result.iterations[~solved] == 200).all() and result.iterations[solved].mean() < 100
    asked = result.watch.queries / result.iterations.sum()
    assert asked == 1.0 if pair is PAIR else asked > 1.0


def test_the_patch_solves_targets_on_faces():
    tasks = accepted(BOXES, 40, ("face-face",))
    plain, patch = (
        run_levenberg_marquardt(
            [BOXES], [tasks], Variant.least_squares(budget=200, witness=witness, epsilon=1e-5, with_closed_form=True)
        )
        for witness in ("plain", "patch")
    )
    judged = errors_at(BOXES, tasks, tasks.T_world_a, patch.T_world_b[:, 0], 1e-3, Patch(1e-5))
    assert (judged < 1e-8).all()
    # By plain witness points, which jump from corner to corner there, the same poses are no better than before.
    assert (plain.error < 1e-8).mean() < 0.5 and (patch.error < 1e-8).mean() < 0.5
