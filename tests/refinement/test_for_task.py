"""Refinement for a task: the same grasps, refined for pushes, for a slippery object, for a heavy one and for a lift."""

from dataclasses import replace

import numpy as np
import pytest

import grasp_refine as gr
from grasp_refine.hands.chain import Chain
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.registry import PROTOCOLS

HEAVY = gr.Task(PROTOCOLS["dexgraspbench"].with_mass(1.5))


@pytest.fixture(scope="module")
def problem() -> gr.Problem:
    """Example grasps of a mug: of the first two, links are below its bottom."""
    return gr.load_problem(gr.ProblemSpec(hand="allegro", object="mug"))


@pytest.fixture(scope="module")
def plain(problem: gr.Problem) -> gr.RefinedGrasps:
    """These grasps, refined for pushes."""
    return gr.refine(problem)


def least_height(scene: gr.Scene) -> np.ndarray:
    """Least height (N,) of the links of each grasp above the bottom of the mug."""
    bodies = [scene.hand.links_by_name[name].solid for name in scene.links]
    T = Chain(scene.hand, scene.links)(scene.T_world_root, scene.q).T_world_link
    return Plane(offset=float(scene.object.mesh.bounds[0, 2])).heights(bodies, T)[0].min(axis=1)


def heights(refined: gr.RefinedGrasps) -> list[np.ndarray]:
    """Least heights (N,) before and after."""
    scene, outcome = refined.problem.groups[0].scene, refined.outcome
    sides = (outcome.hand_pose_before, outcome.q_before), (outcome.hand_pose, outcome.q)
    return [least_height(replace(scene, T_world_root=gr.transform_from_pose(pose), q=q)) for pose, q in sides]


def test_grasps_that_lift_off_a_table_stay_above_it(problem: gr.Problem, plain: gr.RefinedGrasps) -> None:
    lifting = gr.refine(problem.for_task("tabletop"))
    assert all((height[:2] < -0.005).any() for height in heights(plain))
    assert (heights(lifting)[1] > -5e-4).all()
    np.testing.assert_array_equal(lifting.outcome.quality[:2, 0], 0.0)
    assert (lifting.quality[:, 1] > 0.9).all() and gr.simulate(lifting).held[:, 1].all()


def test_grasps_that_are_drawn_for_a_lift_are_above_the_table_as_well(problem: gr.Problem) -> None:
    hand, mug = problem.hand, problem.groups[0].scene.object
    drawn = [gr.sample_grasps(hand, mug, 12, task=task, seed=3) for task in (None, "tabletop")]
    scenes = [gr.problem_of(hand, mug, grasps) for grasps in drawn]
    low = [least_height(one.groups[0].scene) for one in scenes]
    assert (low[0] < -0.005).any() and (low[1] > -5e-4).all()


@pytest.mark.slow
def test_grasps_for_a_heavy_object_press_as_hard_as_it_takes(problem: gr.Problem, plain: gr.RefinedGrasps) -> None:
    both = plain, gr.refine(problem.for_task(HEAVY))
    pressure = [(r.forces.vector * r.forces.normal).sum(axis=1) for r in both]
    totals = [np.bincount(r.forces.grasp, weights=p) for r, p in zip(both, pressure, strict=True)]
    np.testing.assert_allclose(totals[0], 30.0)
    np.testing.assert_allclose(totals[1], 90.0)
    held = [gr.simulate(refined, task=HEAVY).held[:, 1] for refined in both]
    assert held[1].sum() > held[0].sum()
