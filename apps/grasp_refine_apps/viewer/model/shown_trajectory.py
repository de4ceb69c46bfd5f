"""The trajectory of one grasp for display: poses of hand and object over time, and what is in the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import inverse
from grasp_refine.hands.palm import palm_poses
from grasp_refine.motion.plan import LEGS, MotionPlan, PlanStatus
from grasp_refine.motion.sweep import SPACING_M, Obstruction
from grasp_refine.motion.trajectory import trajectory
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.viewer.model.pose import Pose

FRAME_RATE_HZ = 25
"""Frame rate in hertz."""

SQUEEZE, LIFT = LEGS.index("squeeze"), LEGS.index("lift")
"""Numbers of the legs on which the hand presses, and carries the object."""


@dataclass(frozen=True, eq=False)
class ShownTrajectory:
    """T frames of a trajectory, in the object's frame, up to the end of the first leg that is not free."""

    hand: str
    """Name of the hand."""
    object: str
    """Name of the object."""
    status: PlanStatus
    """Result of planning."""
    why: str
    """Obstacle in the way, or leg out of reach, in words; empty where the trajectory is free."""
    time: Float[np.ndarray, " T"]
    """Seconds since the approach began (T,)."""
    leg: Int[np.ndarray, " T"]
    """Number of the leg in `LEGS` (T,)."""
    T_root: Float[np.ndarray, "T 4 4"]
    """Poses of the hand's base link (T, 4, 4)."""
    q: Float[np.ndarray, "T n"]
    """Joint values (T, n) in `Hand.joint_names` order."""
    T_object: Float[np.ndarray, "T 4 4"]
    """Poses of the object (T, 4, 4), which the palm lifts."""
    obstruction: Obstruction | None = None
    """Obstacle that the last leg runs into; None: there is none."""
    other_arm: bool = False
    """Whether the arm reaches the palm's poses in another configuration than that of the grasp."""
    met: int | None = None
    """Number of the frame at which it does."""

    # What simulations have, and trajectories do not.
    direction: ClassVar = "trajectory"
    force: ClassVar = np.zeros(3)
    contacts: ClassVar[tuple[np.ndarray, ...]] = ()
    T_bodies: ClassVar[Mapping[str, np.ndarray]] = MappingProxyType({})

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.time)

    def pose(self, frame: int) -> Pose:
        """Return the pose of the hand in a frame."""
        return Pose(self.T_root[frame], self.q[frame])

    @property
    def reason(self) -> str:
        """Result of planning."""
        return self.status.label

    @property
    def lost(self) -> Bool[np.ndarray, " T"]:
        """True in frames (T,) from where something is in the way."""
        return np.arange(len(self)) >= (len(self) if self.met is None else self.met)

    @property
    def pushed(self) -> Bool[np.ndarray, " T"]:
        """True in frames (T,) in which a push acts: in none."""
        return np.zeros(len(self), dtype=bool)

    def obstruction_at(self, frame: int) -> Obstruction | None:
        """Return what is in the way in a frame; None: nothing yet."""
        return self.obstruction if self.lost[frame] else None

    @property
    def summary(self) -> str:
        """The trajectory in one line."""
        if self.status == PlanStatus.FREE:
            arm = ", with the arm in another configuration" if self.other_arm else ""
            return f"the trajectory is free{arm}: {', '.join(LEGS)} in {self.time[-1]:.1f} s"
        return f"the trajectory is {self.status.label}: {self.why}"

    def text(self, frame: int) -> str:
        """Description of a frame in one line."""
        line = f"{LEGS[self.leg[frame]]}, {self.time[frame]:.2f} s"
        met = self.obstruction_at(frame)
        return line if met is None else f"{line}; {met}"


def shown_trajectory(scene: Scene, plan: MotionPlan, prepared: HandObject) -> ShownTrajectory:
    """Return a trajectory as frames, `FRAME_RATE_HZ` per second.

    Args:
        scene: Hand and object.
        plan: The trajectory of a grasp.
        prepared: The same hand and object.

    Raises:
        GraspRefineError: nothing of the trajectory is known.
    """
    if not plan.legs:
        raise GraspRefineError(f"no way to show: {plan.why}")
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
    known = (time, leg, path.T_world_root, q, T_object, plan.obstruction, plan.other_arm)
    found = ShownTrajectory(hand.name, scene.object.name, plan.status, plan.why, *known)
    return found if plan.obstruction is None else replace(found, met=_met(found, plan, plan.obstruction, prepared))


def _met(shown: ShownTrajectory, plan: MotionPlan, obstruction: Obstruction, prepared: HandObject) -> int:
    """Return the frame whose links are nearest to where they are when the last leg runs into something."""
    last = len(plan.legs) - 1
    path = plan.legs[last].sampled(prepared.chain, prepared.bounding_spheres, SPACING_M)
    at = round(obstruction.share * (len(path) - 1))
    frames = np.flatnonzero(shown.leg == last)
    there = prepared.chain(path.T_world_root[at : at + 1], path.q[at : at + 1]).T_world_link[..., :3, 3]
    links = prepared.chain(shown.T_root[frames], shown.q[frames]).T_world_link[..., :3, 3]
    return int(frames[np.linalg.norm(links - there, axis=-1).max(axis=1).argmin()])
