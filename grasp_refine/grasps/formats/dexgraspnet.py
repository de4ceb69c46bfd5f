"""DexGraspNet: one .npy file per object, named like it, with a list of dicts of named joint values and a scale.

The hand is OpenAI's model of the Shadow hand: joint `robot0:XXJn` is our XXJ(n+1), four of them with the other sign,
and its frame is our palm's. Its links differ from the maker's by up to 2 mm at the little finger.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import pose_from_transform, transform, transform_from_pose
from grasp_refine.grasps.formats.format import Format, Load, Part, check_file_names, omission_notes
from grasp_refine.grasps.formats.layout import SHADOW_FINGERS, SHADOW_THUMB, Layout, check_hand
from grasp_refine.grasps.formats.source import Source
from grasp_refine.grasps.formats.stages import fit_layout
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand

SHADOW = Layout("shadow", "palm", SHADOW_FINGERS + SHADOW_THUMB)
REVERSED_JOINTS = ("FFJ4", "MFJ4", "THJ2", "THJ1")
"""Our joints with the opposite sign in that model."""
JOINTS = tuple(f"robot0:{joint[:3]}{int(joint[3:]) - 1}" for joint in SHADOW.joints)
"""Names of our joints in that model."""
JOINT_SIGNS = np.array([-1.0 if joint in REVERSED_JOINTS else 1.0 for joint in SHADOW.joints])
POSITION = ("WRJTx", "WRJTy", "WRJTz")
ANGLES = ("WRJRx", "WRJRy", "WRJRz")
"""Angles about the fixed axes x, y and z, in this order."""


@dataclass(frozen=True)
class DexGraspNet(Format):
    """Files `object.npy`; other entries of a dict, such as `qpos_st` and `E_fc`, are the optimiser's and not read."""

    name: str = "dexgraspnet"
    what: str = "DexGraspNet: a folder of .npy files, each with all grasps of the object it is named after"
    named_by_path: bool = True

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        if not (isinstance(content, list | tuple) and content):
            return "it is no list of grasps"
        if not all(isinstance(grasp, Mapping) and isinstance(grasp.get("qpos"), Mapping) for grasp in content):
            return "its entries are no dicts with a dict qpos"
        return "" if any(name in content[0]["qpos"] for name in (*POSITION, *ANGLES)) else "its qpos lacks WRJTx"

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of a file."""
        without = [row for row, grasp in enumerate(source.content) if grasp.get("scale") is None]
        if without:
            raise source.error(f"grasp {without[0]} lacks a scale")
        scale = [source.scale(grasp["scale"], f"scale of grasp {row}") for row, grasp in enumerate(source.content)]
        return named_grasps(source, [grasp["qpos"] for grasp in source.content], scale, source.path.stem, hand), ()

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """One file per object."""
        check_file_names(grasps, self.name)
        moved, _ = fit_layout(grasps, (SHADOW,), load, self.name)
        T = transform_from_pose(np.asarray(moved.hand_pose, dtype=float))
        angles = angles_from_rotation(T[:, :3, :3])
        values = np.concatenate([moved.q * JOINT_SIGNS, T[:, :3, 3], angles], axis=1).tolist()
        parts = []
        for name in dict.fromkeys(grasps.object.tolist()):
            rows = np.flatnonzero(grasps.object == name)
            listed = np.empty(len(rows), dtype=object)
            for at, row in enumerate(rows):
                named = dict(zip((*JOINTS, *POSITION, *ANGLES), values[row], strict=True))
                listed[at] = {"qpos": named, "scale": float(grasps.scale[row])}
            parts.append(Part(f"{name}.npy", rows, listed))
        return parts, omission_notes(grasps, SHADOW.joints, stages=False)


def named_grasps(
    source: Source, qpos: Sequence[Mapping[Any, Any]], scale: Sequence[float], name: str, hand: Hand | None
) -> GraspSet:
    """Return grasps with named values of joints, position and angles.

    Args:
        source: File that has them.
        qpos: Values by name, a dict each.
        scale: Factors that take the object's mesh to metres.
        name: Name of the object.
        hand: Hand that the grasps are for; None: the Shadow hand.

    Raises:
        GraspFileError: a name is missing or unknown, or a value is no number.
    """
    check_hand(source, SHADOW, hand)
    wanted = (*JOINTS, *POSITION, *ANGLES)
    rows = []
    for row, values in enumerate(qpos):
        lacking = [name for name in wanted if name not in values]
        unknown = [name for name in values if name not in wanted]
        if lacking or unknown:
            faults = [f"lacks {', '.join(lacking)}"] if lacking else []
            faults += [f"has unknown {', '.join(map(str, unknown))}"] if unknown else []
            raise source.error(f"qpos of grasp {row} {' and '.join(faults)}; its names are {', '.join(wanted)}")
        rows.append([values[name] for name in wanted])
    joints, position, angles = np.split(
        source.numbers(rows, "qpos", (None, len(wanted))), [len(JOINTS), len(JOINTS) + 3], axis=1
    )
    poses = pose_from_transform(transform(rotation_from_angles(angles), position))
    return SHADOW.grasps(hand, poses, joints * JOINT_SIGNS, object=name, scale=np.array(scale))


def rotation_from_angles(angles: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3 3"]:
    """Rotations R = R_z R_y R_x (N, 3, 3) about the fixed axes x, y, z, in this order (N, 3)."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles).T, np.sin(angles).T
    rows = (
        (cy * cz, sx * sy * cz - cx * sz, cx * sy * cz + sx * sz),
        (cy * sz, sx * sy * sz + cx * cz, cx * sy * sz - sx * cz),
        (-sy, sx * cy, cx * cy),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def angles_from_rotation(R: Float[np.ndarray, "N 3 3"]) -> Float[np.ndarray, "N 3"]:
    """Angles (N, 3) for `rotation_from_angles`, the second in [-pi/2, pi/2]; where it is at an end, the third is 0."""
    cosine = np.hypot(R[:, 0, 0], R[:, 1, 0])
    free = cosine > 1e-9
    x = np.where(free, np.arctan2(R[:, 2, 1], R[:, 2, 2]), np.arctan2(-R[:, 1, 2], R[:, 1, 1]))
    y = np.arctan2(-R[:, 2, 0], cosine)
    z = np.where(free, np.arctan2(R[:, 1, 0], R[:, 0, 0]), 0.0)
    return np.stack([x, y, z], axis=1)
