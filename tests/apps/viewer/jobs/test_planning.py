"""Trajectories as frames: the object goes with the palm, and what is in the way is met where links are in it first."""

import numpy as np
import pytest

from grasp_refine.closing.motion import Motion
from grasp_refine.core.rpy_poses import transform_from_rpy
from grasp_refine.core.se3 import inverse
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box
from grasp_refine.hands.hand import load_hand
from grasp_refine.motion.plan import LEGS, plan_motions
from grasp_refine.motion.sweep import SPACING_M
from grasp_refine.objects.object import load_object
from grasp_refine.scene.environment import Environment, EnvironmentBody
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.jobs.planning import trajectory_recording
from grasp_refine_apps.viewer.model.recording import Recording
from open_viewer import settled

LIFT_M = 0.1
PRESS_M = 0.01


def grasp(*bodies: EnvironmentBody) -> tuple[Scene, Motion, HandObject]:
    """A gripper on a box from above, open before it; set points of the squeeze press."""
    hand, thing = load_hand("franka_hand", candidates=16), load_object("box:0.05,0.05,0.12", candidates=16)
    T = transform_from_rpy([0.0, 0.0, 0.06 - 0.02 + 0.1034, 180.0, 0.0, 0.0])
    fingers = np.array([[0.036], [0.025], [0.025 - PRESS_M]])
    environment = Environment(bodies, np.eye(4), lift=0.0) if bodies else None
    scene = Scene(hand, thing, T, fingers[1], task=Task(scene=environment))
    return scene, Motion(np.tile(T, (1, 3, 1, 1)), fingers[None]), HandObject.of(scene)


def shown(*bodies: EnvironmentBody) -> tuple[Scene, HandObject, Recording]:
    scene, motion, prepared = grasp(*bodies)
    return scene, prepared, trajectory_recording(scene, plan_motions(scene, motion, prepared=prepared)[0], prepared)


def post(top: float) -> EnvironmentBody:
    """A post beside the object, below one finger, up to a height."""
    T = np.eye(4)
    T[:3, 3] = 0.0, 0.03 + 0.1, top - 0.1
    return EnvironmentBody("post", build_body("post", [box((0.2, 0.2, 0.2))], candidates=16), T)


def test_the_object_goes_up_with_the_palm_and_fingers_stay_on_it() -> None:
    _, _, plan = shown()
    assert plan.succeeds and plan.obstruction is None and not plan.lost.any()
    leg = np.array([LEGS.index(text.partition(",")[0]) for text in plan.texts])
    assert sorted(set(leg)) == list(range(len(LEGS))) and (np.diff(plan.time) > 0).all()
    np.testing.assert_allclose(plan.T_object[-1, :3, 3], [0.0, 0.0, LIFT_M], atol=1e-9)
    at_grasp = inverse(plan.T_root[np.flatnonzero(leg == LEGS.index("lift"))[0] - 1])
    held = inverse(plan.T_root[leg == LEGS.index("lift")]) @ plan.T_object[leg == LEGS.index("lift")]
    np.testing.assert_allclose(held, np.broadcast_to(at_grasp, held.shape), atol=1e-9)
    # Set points press, fingers do not go into the object.
    np.testing.assert_allclose(plan.q[leg >= LEGS.index("squeeze")], 0.025, atol=1e-9)
    resting = plan.T_object[leg < LEGS.index("lift")]
    np.testing.assert_array_equal(resting, np.broadcast_to(np.eye(4), resting.shape))


def lowest(scene: Scene, prepared: HandObject, plan: Recording) -> np.ndarray:
    """Height of the lowest point of the hand in each frame (T,), metres."""
    T = prepared.chain(plan.T_root, plan.q).T_world_link
    heights, _ = Plane().heights(prepared.bodies, T)
    return heights.min(axis=1)


@pytest.mark.parametrize("height", [0.02, 0.06])
def test_a_post_below_a_finger_is_met_in_the_frame_in_which_the_finger_reaches_it(height: float) -> None:
    tip = lowest(*shown())[-1] - LIFT_M
    scene, prepared, plan = shown(post(tip + height))
    met = int(plan.lost.argmax())
    assert not plan.succeeds and plan.obstruction is not None and plan.lost[met]
    assert plan.obstruction.second == "post" and "post" in plan.text(met) and "post" in plan.summary
    assert "post" not in plan.text(met - 1) and plan.obstruction_at(met - 1) is None
    z = lowest(scene, prepared, plan)
    step = np.abs(np.diff(z)).max()
    # Samples of the sweep and frames are each a little apart.
    assert z[met] == pytest.approx(tip + height, abs=SPACING_M + step)
    assert plan.lost.tolist() == [frame >= met for frame in range(len(plan))]


def test_planning_is_kept_until_the_grasp_is_moved(viewer: Controller) -> None:
    viewer.simulation.plan_trajectory()
    settled(viewer, 60.0)
    plan = viewer.state.work.plan
    assert isinstance(plan, Recording) and viewer.state.motion is plan and len(plan) > 20
    viewer.player.show(None)
    viewer.simulation.plan_trajectory()
    assert viewer.state.job is None and viewer.state.motion is plan
    viewer.player.show(None)
    viewer.editor.set_joint(0, viewer.state.pose.q[0] + 0.05)
    assert viewer.state.work.plan is None
