"""Closed form of alignment tasks: opposite normals at the targets."""

from __future__ import annotations

import numpy as np
import pytest

from alignment_errors import errors_at
from grasp_refine.collision.query import Pairs
from grasp_refine_apps.bench.align.bodies import BodyPair, normalised
from grasp_refine_apps.bench.align.closed_form import ClosedForm, run_closed_form
from grasp_refine_apps.bench.align.tasks import CLASSES, Tasks, draw_tasks
from grasp_refine_apps.bench.align.variants import Variant
from shapes_for_tests import cluster_body, convex_body, ring_body

PAIR = BodyPair("hulls", "convex", normalised(convex_body(1, 24), 0.06), normalised(convex_body(2, 24), 0.09))
OTHER = BodyPair("others", "convex", normalised(convex_body(3, 40), 0.03), normalised(convex_body(4, 16), 0.12))
CONCAVE = BodyPair("ring and cluster", "concave", normalised(ring_body(), 0.12), normalised(cluster_body(3, 4), 0.1))


def accepted(pair: BodyPair, count: int) -> Tasks:
    tasks = draw_tasks(pair, CLASSES[:3], count, 0)
    return tasks.take(np.flatnonzero(tasks.accepted))


def form(pair: BodyPair, tasks: Tasks) -> ClosedForm:
    return ClosedForm(Pairs((pair.a,), (pair.b,)), np.zeros(len(tasks), dtype=int), tasks, 1e-3)


@pytest.mark.parametrize("roll", [0.0, 2.0])
@pytest.mark.parametrize("pair", [PAIR, OTHER], ids=["hulls", "others"])
def test_opposite_normals_at_the_targets_solve_tasks_of_convex_bodies(pair: BodyPair, roll: float):
    tasks = accepted(pair, 24)
    T_b = form(pair, tasks).poses(np.arange(len(tasks)), tasks.T_world_b, np.full(len(tasks), roll))
    np.testing.assert_allclose(np.linalg.det(T_b[:, :3, :3]), 1.0, rtol=1e-12)
    assert errors_at(pair, tasks, tasks.T_world_a, T_b, 1e-3).max() < 1e-16


def test_alone_it_solves_convex_tasks_and_not_all_concave_ones():
    """One pose a task, of several pairs at once; a pair of fewer tasks repeats them without running them."""
    pairs = [PAIR, CONCAVE, OTHER]
    tasks = [accepted(PAIR, 24), accepted(CONCAVE, 24), accepted(OTHER, 9)]
    result = run_closed_form(pairs, tasks, Variant.closed_form(margin=1e-3))
    counts = [len(its) for its in tasks]
    assert result.iterations.sum(axis=0).tolist() == counts and result.iterations.max() == 1
    convex, concave, other = (result.error[:count, p] for p, count in enumerate(counts))
    assert max(convex.max(), other.max()) < 1e-16
    assert 0.0 < (concave < 1e-6).mean() < 1.0
    np.testing.assert_allclose(
        concave, errors_at(CONCAVE, tasks[1], tasks[1].T_world_a, result.T_world_b[: counts[1], 1], 1e-3), atol=1e-18
    )
    np.testing.assert_array_equal(
        result.error[counts[2] : 2 * counts[2], 2], other[: counts[2]][: max(counts) - counts[2]]
    )
