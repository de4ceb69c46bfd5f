"""LEAP_Hand_Sim's cache of grasps: one .npy file, (N, 23) float32, the palm at a fixed pose and the cube in the hand.

A row is 16 joint values, then x y z (metres), qx qy qz qw of the cube in the world. The object is not named; the
file's name ends with the scale, s10 being 1.0 times the cube of 75 mm.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import inverse, pose_from_transform, transform_from_pose
from grasp_refine.grasps.formats.format import Format, Load, Part, omission_notes
from grasp_refine.grasps.formats.layout import Layout, check_hand
from grasp_refine.grasps.formats.source import Source
from grasp_refine.grasps.formats.stages import fit_layout
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand

JOINTS = ("1", "0", "2", "3", "12", "13", "14", "15", "5", "4", "6", "7", "9", "8", "10", "11")
LEAP = Layout("leap", "palm_lower", JOINTS)
PALM_POSE = np.array([0.0, 0.0, 0.5, 0.0, 1.0, 0.0, 0.0])
"""Pose (7,) of the palm in the world of that simulation: turned by pi about x."""
CUBE = "box:0.075,0.075,0.075"
"""The cube, as our commands name it."""
SCALE_SUFFIX = re.compile(r"_s([0-9])([0-9]+)$")
"""Scale at the end of a file's name: 0.9 is s09, 1.05 is s105."""
NUM_COLUMNS = len(JOINTS) + 7


@dataclass(frozen=True)
class LeapCache(Format):
    """Files `*_grasp_*_s10.npy` for the cube in the LEAP hand."""

    name: str = "leap_cache"
    what: str = "LEAP_Hand_Sim: one .npy file of (N, 23) numbers, the LEAP hand with a cube"

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        if not isinstance(content, np.ndarray) or content.dtype.kind != "f":
            return "it is no array of numbers"
        if content.ndim != 2 or content.shape[1] != NUM_COLUMNS or not len(content):
            return f"it is no array (N, {NUM_COLUMNS}) but {content.shape}"
        return ""

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of a file."""
        check_hand(source, LEAP, hand)
        values = source.numbers(source.content, "the array", (None, NUM_COLUMNS))
        # x y z qx qy qz qw becomes x y z qw qx qy qz.
        pose = values[:, [16, 17, 18, 22, 19, 20, 21]]
        T_world_object = transform_from_pose(source.poses(pose, "the pose of the cube in columns 16 to 22"))
        scale = SCALE_SUFFIX.search(source.path.stem)
        factor = float(f"{scale[1]}.{scale[2]}") if scale else 1.0
        poses = pose_from_transform(inverse(T_world_object) @ transform_from_pose(PALM_POSE))
        grasps = LEAP.grasps(hand, poses, values[:, : len(JOINTS)], object=CUBE, scale=factor)
        notes = [] if scale else [f"the file's name does not end with a scale such as _s10: the cube is {CUBE}"]
        if (grasps.scale <= 0).any():
            raise source.error(f"its name ends with the scale {scale[0] if scale else ''}, which must be positive")
        return grasps, notes

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """One file, if all grasps are of one object."""
        objects = sorted({*zip(grasps.object.tolist(), grasps.scale.tolist(), strict=True)})
        if len(objects) > 1:
            listing = ", ".join(f"{name} (scale {scale:g})" for name, scale in objects)
            raise GraspFileError(f"format {self.name} holds grasps of one object and scale; there are {listing}")
        moved, _ = fit_layout(grasps, (LEAP,), load, self.name)
        T_object_palm = transform_from_pose(np.asarray(moved.hand_pose, dtype=float))
        pose = pose_from_transform(transform_from_pose(PALM_POSE) @ inverse(T_object_palm))
        rows = np.concatenate([moved.q, pose[:, [0, 1, 2, 4, 5, 6, 3]]], axis=1).astype(np.float32)
        name, scale = objects[0]
        lost = []
        if (name, scale) != (CUBE, 1.0):
            lost.append(
                f"object '{name}' and its scale {scale:g} have no place in this format: it means {CUBE}, times the "
                "scale at the end of the file's name, such as _s10 for 1.0"
            )
        lost += omission_notes(grasps, grasps.joint_names, stages=False)
        return [Part("grasps.npy", np.arange(len(grasps)), rows)], lost
