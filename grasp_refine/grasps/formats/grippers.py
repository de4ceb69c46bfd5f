"""Hands of files that say which gripper they are for, but not by our name."""

from __future__ import annotations

from pathlib import PurePosixPath

from grasp_refine.grasps.formats.folders import UNUSUAL

FRANKA = "franka_hand"
"""Our name of the Franka hand, which begins at its link panda_hand."""
FRANKA_LINK = "panda_hand"
FRANKA_JOINTS = ("panda_finger_joint1", "panda_finger_joint2")
"""Its joints: how far each finger is from the middle, metres. The second follows the first."""
FRANKA_NAMES = ("panda", "franka", "franka_panda", "panda_hand", "panda_gripper", "franka_hand")
"""Names of it in files."""


def hand_named(text: str) -> str:
    """Return our name of the hand that a path or a name of a gripper means, or the name itself."""
    parts = PurePosixPath(text.replace("\\", "/"))
    name = parts.stem if parts.suffix.lower() in (".usd", ".usda", ".usdc", ".urdf", ".xml") else parts.name
    return FRANKA if name.lower() in FRANKA_NAMES else UNUSUAL.sub("_", name) or "gripper"
