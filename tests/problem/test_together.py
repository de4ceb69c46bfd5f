"""Grasps on several objects that are refined together: each gets the result that it gets alone."""

from dataclasses import replace

import numpy as np
import pytest

import grasp_refine as gr
from compiled import needs_compiled
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.problem.facade import problem_of
from grasp_refine.problem.problem import Group
from grasp_refine.problem.refine import refine_group, refine_together
from grasp_refine.problem.together import sets_of, together
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.scene.scene import Scene
from refusals import refused

SIZES = ("box:0.04,0.05,0.06", "sphere:0.03", "cylinder:0.02,0.08")


def group_on(hand: gr.Hand, source: str, count: int) -> Group:
    """Grasps of a hand on an object, not quite at it."""
    obj = gr.load_object(source, candidates=128)
    grasps = gr.sample_grasps(hand, obj, count, seed=1)
    pose = grasps.hand_pose.copy()
    pose[:, :3] += np.random.default_rng(2).normal(scale=0.002, size=(count, 3))
    (group,) = problem_of(hand, obj, replace(grasps, hand_pose=pose)).groups
    return group


@pytest.fixture(scope="module", params=["allegro", "franka_hand"])
def groups(request: pytest.FixtureRequest) -> list[Group]:
    """Grasps of a hand that touches in points, and of jaws that lie on flat faces of some objects."""
    hand = gr.load_hand(request.param)
    return [group_on(hand, source, count) for source, count in zip(SIZES, (2, 1, 3), strict=True)]


@needs_compiled
def test_grasps_refined_together_are_the_grasps_refined_alone(groups: list[Group]) -> None:
    groups = [replace(group, scene=replace(group.scene, task=gr.Task(table=-0.2))) for group in groups]
    config = Config(starts=2, solver=LevenbergMarquardt(iterations=15))
    (set_,) = sets_of(groups, config)
    both = zip(groups, refine_together(set_, config), strict=True)
    for group, found in both:
        alone = refine_group(group, config)
        for name in ("hand_pose", "q", "stage_q", "quality", "status"):
            np.testing.assert_array_equal(getattr(found, name), getattr(alone, name), name)
        assert set(found.object) == {group.object} and len(found) == len(group.rows)


def test_each_hand_meets_its_own_object(groups: list[Group]) -> None:
    scene = together([group.scene for group in groups])
    assert [scene.objects[k] for k in scene.number] == [
        group.scene.object for group in groups for _ in range(len(group.rows))
    ]
    prepared = scene.select(slice(None))
    assert len(prepared.objects) == 3
    back = scene.select(np.array([5, 0]))
    np.testing.assert_array_equal(back.number, [2, 0])
    np.testing.assert_array_equal(
        back.centers(np.arange(2)), [groups[2].scene.object.center_of_mass, groups[0].scene.object.center_of_mass]
    )


def test_grasps_whose_task_differs_are_refined_apart(groups: list[Group]) -> None:
    first, *others = groups
    hand = first.scene.hand
    heavy = gr.Task(replace(gr.Protocol("heavy"), mass=1.0))
    on_table = [replace(group, scene=replace(group.scene, task=gr.Task(table=-0.2))) for group in groups]
    elsewhere = replace(first, scene=replace(first.scene, task=gr.Task(avoid=("above:z=0.02",))))
    assert [len(one) for one in sets_of([first, replace(first, scene=replace(first.scene, task=heavy))], Config())] == [
        1,
        1,
    ]
    assert [len(one) for one in sets_of(on_table, Config())] == [3], "the same table for all"
    assert [len(one) for one in sets_of([elsewhere, elsewhere], Config())] == [1, 1], "regions are of one object"
    assert [len(one) for one in sets_of(groups, Config(width=3))] == [2, 1], "no more grasps than there is room for"
    assert [len(one) for one in sets_of(groups, Config(solver=Descent()))] == [1, 1, 1]
    assert hand is others[0].scene.hand


def test_scenes_of_several_objects_that_cannot_be_are_refused(groups: list[Group]) -> None:
    scene = together([group.scene for group in groups])
    with refused(GraspRefineError, "levenberg-marquardt"):
        refine(scene, Config(solver=Descent()))
    with refused(GraspRefineError, "of_object", "3"):
        replace(scene, of_object=np.full(6, 3))
    with refused(GraspRefineError, "of_object"):
        replace(scene, of_object=np.zeros(2, dtype=int))
    one = groups[0].scene
    lifted = gr.Task("tabletop")
    with refused(GraspRefineError, "several objects", "table"):
        Scene(one.hand, one.object, one.T_world_root, one.q, task=lifted, others=(groups[2].scene.object,))
