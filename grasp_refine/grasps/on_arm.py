"""Grasps of a hand as grasps of the same hand on an arm, by inverse kinematics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspFileError, HandError
from grasp_refine.core.se3 import pose_from_transform, transform_from_pose
from grasp_refine.grasps.grasp_set import GraspSet, match_joints
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.inverse_kinematics import STARTS, ArmKinematics

ArmClearance = Callable[[Float[np.ndarray, "M 4 4"], Float[np.ndarray, "M n"]], Float[np.ndarray, " M"]]
"""Returns the distances (M,) in metres of the arm from its surroundings, at base poses in the object's frame and joint
values; at most `ROOM_M`, negative where it runs into something."""

ROOM_M = 0.03
"""Distance in metres beyond which more is no better: configurations with less are a fallback."""


def on_arm(
    grasps: GraspSet,
    hand: Hand,
    T_object_base: Float[np.ndarray, "4 4"],
    *,
    clearance: ArmClearance | None = None,
    starts: int = STARTS,
    seed: int = 0,
) -> tuple[GraspSet, tuple[str, ...]]:
    """Return grasps of a hand as grasps of the hand on an arm, and notes.

    The base of the arm has the given pose, and its joints bring the palm to the pose of each grasp: of the solutions
    of inverse kinematics, without self-collision and with room around them, the best one, see
    `ArmKinematics.solve`. Joint values of the arm are NaN where there is none. Pregrasps and squeezes are left out, as
    they may move the palm; grasps that begin at the base of the arm already are returned as they are.

    Args:
        grasps: Grasps with poses of the palm, `hand.palm`, or of the arm's base.
        hand: The hand on its arm.
        T_object_base: Pose (4, 4) of the base of the arm in the object's frame.
        clearance: Distance of the arm from its surroundings; None: there are none.
        starts: Number of starts of the inverse kinematics for each grasp.
        seed: Seed of the starts.

    Raises:
        GraspFileError: the grasps begin at another link, or are of another hand.
        HandError: the hand is on no arm.
    """
    if hand.arm is None:
        raise HandError(f"hand {hand.name} is on no arm: mount(arm, hand) puts it on one")
    if grasps.base_link == hand.base_link:
        return grasps, ()
    if grasps.base_link != hand.palm:
        raise GraspFileError(
            f"the grasps give poses of link '{grasps.base_link}'; on an arm they must be poses of its palm, "
            f"'{hand.palm}', or of its base, '{hand.base_link}'"
        )
    values, notes = match_joints(_without_arm(grasps, hand), _without_arm_joints(hand))
    count = len(grasps)
    T_base = np.broadcast_to(T_object_base, (count, 4, 4))
    kinematics = ArmKinematics(hand)
    found = kinematics.solve(T_base, values, transform_from_pose(grasps.hand_pose), starts=starts, seed=seed)
    usable, roomy = found.free.copy(), found.free.copy()
    if clearance is not None and usable.any():
        row, way = np.nonzero(usable)
        room = clearance(T_base[row], found.q[row, way])
        usable[row, way], roomy[row, way] = room > 0.0, room >= ROOM_M
    first = np.where(roomy.any(axis=1), roomy.argmax(axis=1), usable.argmax(axis=1))
    q = found.q[np.arange(count), first]
    q[np.ix_(~usable.any(axis=1), hand.arm_joints)] = np.nan
    if grasps.other_stages:
        notes = (*notes, f"{' and '.join(grasps.other_stages)} of the grasps are left out: the arm has its own")
    moved = replace(
        grasps,
        hand=hand.name,
        base_link=hand.base_link,
        joint_names=hand.joint_names,
        hand_pose=pose_from_transform(T_base),
        q=q,
        pregrasp=None,
        squeeze=None,
    )
    return moved, notes


def _without_arm(grasps: GraspSet, hand: Hand) -> GraspSet:
    """Return the grasps without columns of the arm's joints, which their pose replaces."""
    names = {name for name, arm in zip(hand.joint_names, hand.arm_joints, strict=True) if arm}
    kept = [column for column, name in enumerate(grasps.joint_names) if name not in names]
    return replace(
        grasps,
        joint_names=tuple(grasps.joint_names[column] for column in kept),
        q=grasps.q[:, kept],
        pregrasp=None,
        squeeze=None,
    )


def _without_arm_joints(hand: Hand) -> Hand:
    """Return the part of a hand that grasps, with which joints are matched by name."""
    own, arm = ~hand.arm_joints, hand.arm
    assert arm is not None
    return replace(
        hand,
        base_link=arm.palm,
        links=tuple(link for link in hand.links if link.name not in arm.links),
        joints=tuple(joint for joint in hand.joints if joint.parent not in arm.links),
        joint_names=tuple(np.array(hand.joint_names)[own].tolist()),
        lower=hand.lower[own],
        upper=hand.upper[own],
        rest=hand.rest[own],
        arm=None,
        parts=(),
    )
