"""Refinement for a task: the same grasps, refined for pushes, for a slippery object, for a heavy one and for a lift."""

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


def heights(refined: gr.RefinedGrasps, side: int) -> np.ndarray:
    """Least height (N,) of the links of each grasp above the bottom of the mug, before and after."""
    scene, outcome = refined.problem.groups[0].scene, refined.outcome
    pose, q = (outcome.hand_pose_before, outcome.q_before) if side == 0 else (outcome.hand_pose, outcome.q)
    bodies = [scene.hand.links_by_name[name].solid for name in scene.links]
    T = Chain(scene.hand, scene.links)(gr.transform_from_pose(pose), q).T_world_link
    return Plane(offset=float(scene.object.mesh.bounds[0, 2])).heights(bodies, T)[0].min(axis=1)


def test_grasps_that_lift_off_a_table_stay_above_it(problem: gr.Problem) -> None:
    plain, lifting = gr.refine(problem), gr.refine(problem.for_task("tabletop"))
    assert (heights(plain, 0)[:2] < -0.005).all() and (heights(plain, 1)[:2] < -0.005).any()
    assert (heights(lifting, 1) > -5e-4).all()
    np.testing.assert_array_equal(lifting.outcome.quality[:2, 0], 0.0)
    assert (lifting.quality[:, 1] > 0.9).all() and gr.simulate(lifting).held[:, 1].all()


def test_grasps_for_a_heavy_object_press_as_hard_as_it_takes(problem: gr.Problem) -> None:
    light, heavy = gr.refine(problem), gr.refine(problem.for_task(HEAVY))
    pressure = [(r.forces.vector * r.forces.normal).sum(axis=1) for r in (light, heavy)]
    totals = [np.bincount(r.forces.grasp, weights=p) for r, p in zip((light, heavy), pressure, strict=True)]
    np.testing.assert_allclose(totals[0], 30.0)
    np.testing.assert_allclose(totals[1], 90.0)
    held = [gr.simulate(refined, task=HEAVY).held[:, 1] for refined in (light, heavy)]
    assert held[1].sum() > held[0].sum()
