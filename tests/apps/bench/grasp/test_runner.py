"""Jobs: which tasks go together, and what they are refined with."""

from __future__ import annotations

from typing import get_args

import numpy as np

from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.bench.grasp.runner import calls
from grasp_refine_apps.bench.grasp.study import GraspStudy
from grasp_refine_apps.bench.grasp.tasks import Tasks
from grasp_refine_apps.bench.grasp.variants import SOLVERS, DerivativeName, Variant


def test_first_order_solvers_are_called_batch_by_batch():
    assert calls(5, Variant(batch=2)) == [(0, 5)]
    assert calls(5, Variant("adam", batch=2)) == [(0, 2), (2, 4), (4, 5)]
    assert calls(3, Variant(batch=1)) == calls(3, Variant("descent", batch=1)) == [(0, 1), (1, 2), (2, 3)]


def test_single_tasks_come_evenly_from_all_objects():
    hand, ball = load_hand("allegro", candidates=16), load_object("sphere:0.03", candidates=16)
    scene = Scene(hand, ball, np.tile(np.eye(4), (6, 1, 1)), np.tile(hand.rest, (6, 1)))
    sets = [("balls", "nothing", tuple(Tasks(name, 1.0, scene, np.arange(6)) for name in "abc"))]
    one, few = GraspStudy((Variant(batch=1), Variant(batch=2)), singles=4).set_tasks(sets)
    (rest,) = GraspStudy((Variant(batch=1),), singles=2).set_tasks(sets)
    assert [len(its) for its in one.tasks] == [2, 1, 1]
    assert [len(its) for its in few.tasks] == [6, 6, 6]
    assert [its.object for its in rest.tasks] == ["a", "b"] and [len(its) for its in rest.tasks] == [1, 1]
    assert few.job.work == 18 / 4 * one.job.work and one.job.label == "balls, levenberg-marquardt, batch 1"


def test_a_variant_says_all_that_is_refined_with():
    for solver in SOLVERS:
        for derivative in get_args(DerivativeName):
            config = Variant(solver, derivative, 7, 5).config(seed=3, tolerance=1e-9)
            assert isinstance(config.solver, SOLVERS[solver]) and config.solver.iterations == 7
            assert (config.width, config.seed, config.tolerance) == (5, 3, 1e-9)
            assert getattr(config.derivative, "seed", 3) == 3 and not config.holds
    assert Variant("adam").columns()["budget"] == SOLVERS["adam"]().iterations
