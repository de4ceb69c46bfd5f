"""Hands of files that say which gripper they are for, but not by our name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.grasps.formats.folders import UNUSUAL
from grasp_refine.grasps.grasp_set import GraspSet, Stage
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.jaws import jaws_of

FRANKA = "franka_hand"
"""Our name of the Franka hand, which begins at its link panda_hand."""
FRANKA_LINK = "panda_hand"
FRANKA_JOINTS = ("panda_finger_joint1", "panda_finger_joint2")
"""Its joints: how far each finger is from the middle, metres. The second follows the first."""
MAX_APART_M = 1e-6
"""Greatest difference between the two at which the second is said to follow, metres."""
FRANKA_NAMES = ("panda", "franka", "franka_panda", "panda_hand", "panda_gripper", "franka_hand")
"""Names of it in files."""


def hand_named(text: str) -> str:
    """Return our name of the hand that a path or a name of a gripper means, or the name itself."""
    parts = PurePosixPath(text.replace("\\", "/"))
    name = parts.stem if parts.suffix.lower() in (".usd", ".usda", ".usdc", ".urdf", ".xml", ".mjcf") else parts.name
    return FRANKA if name.lower() in FRANKA_NAMES else UNUSUAL.sub("_", name) or "gripper"


def without_follower(grasps: GraspSet) -> GraspSet:
    """Return grasps of the Franka hand without its second finger, if that is everywhere where the first one is."""
    if set(grasps.joint_names) != set(FRANKA_JOINTS):
        return grasps
    first, second = (grasps.joint_names.index(name) for name in FRANKA_JOINTS)
    stages: list[GraspSet | Stage] = [grasps, *grasps.other_stages.values()]
    if any(np.abs(stage.q[:, first] - stage.q[:, second]).max() > MAX_APART_M for stage in stages):
        return grasps
    others: dict[str, Any] = {
        name: Stage(stage.pose, stage.q[:, [first]]) for name, stage in grasps.other_stages.items()
    }
    return replace(grasps, joint_names=FRANKA_JOINTS[:1], q=grasps.q[:, [first]], **others)


def open_joints(hand: Hand | None, count: int) -> tuple[tuple[str, ...], Float[np.ndarray, "N n"], str]:
    """Return joints and values (N, n) of grasps of a file without any, and a note: jaws are open, other hands at rest.

    Args:
        hand: The hand that the user gave.
        count: Number of grasps.
    """
    jaws = None if hand is None else jaws_of(hand)
    if hand is None or jaws is None:
        return (), np.zeros((count, 0)), "the file has no joint values, only poses of the gripper"
    opened = jaws.opened != hand.rest
    names = tuple(name for name, opens in zip(hand.joint_names, opened, strict=True) if opens)
    return (
        names,
        np.tile(jaws.opened[opened], (count, 1)),
        f"the file has no joint values: the jaws are taken to be open ({', '.join(names)})",
    )
