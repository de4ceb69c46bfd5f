"""Planning of the trajectory of one grasp, with progress and interruption."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import inverse
from grasp_refine.hands.palm import palm_poses
from grasp_refine.motion.plan import LEGS, MotionPlan, PlanStatus, plan_motions
from grasp_refine.motion.sweep import SPACING_M, Obstruction
from grasp_refine.motion.trajectory import trajectory
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.jobs.validating import PosedGrasp
from grasp_refine_apps.viewer.jobs.worker import Control
from grasp_refine_apps.viewer.model.pose import posed_scene
from grasp_refine_apps.viewer.model.recording import Recording

FRAME_RATE_HZ = 25
"""Frame rate in hertz."""

SQUEEZE, LIFT = LEGS.index("squeeze"), LEGS.index("lift")
"""Numbers of the legs on which the hand presses, and carries the object."""


def plan_trajectory(grasp: PosedGrasp, control: Control) -> Recording:
    """Plan the trajectory of one grasp, as `refine-grasp run --trajectory` does.

    Args:
        grasp: The grasp.
        control: Receives a description of the present step, and can stop the planning between steps.

    Raises:
        GraspRefineError: there is no grasp, or it is out of reach.
        Stopped: the job was stopped.
    """
    control.describe("planning the trajectory: opening and closing the hand")
    motion, _ = grasp.motion(control.check)
    control.describe("planning the trajectory: approach and lift")
    control.check()
    scene = posed_scene(grasp.scene, grasp.pose)
    prepared = grasp.prepared or HandObject.of(scene)
    (plan,) = plan_motions(scene, motion, prepared=prepared)
    control.check()
    return trajectory_recording(scene, plan, prepared)


def trajectory_recording(scene: Scene, plan: MotionPlan, prepared: HandObject) -> Recording:
    """Return a trajectory as a recording, `FRAME_RATE_HZ` frames per second, to the end of the first blocked leg.

    Args:
        scene: Hand and object.
        plan: The trajectory of a grasp.
        prepared: The same hand and object.

    Raises:
        GraspRefineError: nothing of the trajectory is known.
    """
    if not plan.legs:
        raise GraspRefineError(f"no trajectory to show: {plan.why}")
    hand, timed = scene.hand, trajectory(scene.hand, plan)
    time, _, path, leg = timed.sampled(1.0 / FRAME_RATE_HZ)
    q = path.q
    if len(plan.legs) > SQUEEZE:
        # Set points press into the object, fingers stay where they touch it.
        presses = (leg >= SQUEEZE)[:, None] & ~hand.arm_joints
        q = np.where(presses, plan.legs[SQUEEZE].q[0], q)
    T_palm = palm_poses(hand, path.T_world_root, path.q)
    T_object = np.tile(np.eye(4), (len(time), 1, 1))
    carried = np.flatnonzero(leg == LIFT)
    if len(carried):
        start = palm_poses(hand, plan.legs[LIFT].T_world_root[:1], plan.legs[LIFT].q[:1])
        T_object[carried] = T_palm[carried] @ inverse(start)
    end = len(time) if plan.obstruction is None else _met(leg, path.T_world_root, q, plan, plan.obstruction, prepared)
    lost = np.arange(len(time)) >= end
    texts = (f"{LEGS[number]}, {seconds:.2f} s" for number, seconds in zip(leg, time, strict=True))
    return Recording(
        title=f"trajectory, {plan.status.label}",
        T_root=path.T_world_root,
        q=q,
        time=time,
        texts=tuple(f"{text}; {plan.obstruction}" if met else text for text, met in zip(texts, lost, strict=True)),
        T_object=T_object,
        lost=lost,
        obstruction=plan.obstruction,
        summary=_summary(plan, time[-1]),
        succeeds=plan.status == PlanStatus.FREE,
        travels=True,
        carries=True,
    )


def _summary(plan: MotionPlan, seconds: float) -> str:
    """A trajectory in one line."""
    if plan.status == PlanStatus.FREE:
        arm = ", with the arm in another configuration" if plan.other_arm else ""
        return f"the trajectory is free{arm}: {', '.join(LEGS)} in {seconds:.1f} s"
    return f"the trajectory is {plan.status.label}: {plan.why}"


def _met(
    leg: Int[np.ndarray, " T"],
    T_root: Float[np.ndarray, "T 4 4"],
    q: Float[np.ndarray, "T n"],
    plan: MotionPlan,
    obstruction: Obstruction,
    prepared: HandObject,
) -> int:
    """Return the frame whose links are nearest to where they are when the last leg runs into something."""
    last = len(plan.legs) - 1
    path = plan.legs[last].sampled(prepared.chain, prepared.bounding_spheres, SPACING_M)
    at = round(obstruction.share * (len(path) - 1))
    frames = np.flatnonzero(leg == last)
    there = prepared.chain(path.T_world_root[at : at + 1], path.q[at : at + 1]).T_world_link[..., :3, 3]
    links = prepared.chain(T_root[frames], q[frames]).T_world_link[..., :3, 3]
    return int(frames[np.linalg.norm(links - there, axis=-1).max(axis=1).argmin()])
