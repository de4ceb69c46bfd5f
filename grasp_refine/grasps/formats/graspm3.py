"""GraspM3: trajectories of a hand above a table, one .npy file per object; the frame before the lift is the grasp.

A dict of `grasp_seqs` (N, T, 6 + n), `obj_rotmat` (N, 3, 3) and `obj_scale` (N,). A frame is the position of the hand's
root link, metres, its angles a, b, c about the rotated axes x, y and z, R = Rx(a) Ry(b) Rz(c), and the driven joints.
The origin is on the table, z upwards; the object, turned by `obj_rotmat`, stands there, so its height follows from its
mesh. Source: the Motion Challenge of 2026, `linkerhand_o6_right6d.urdf` and `o6_hand_grasp_dexrep_ijrr.py` of
DexGraspMotionChallenge/DexGraspMotionChallenge2026.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import MeshError
from grasp_refine.core.names import is_file
from grasp_refine.core.se3 import inverse, pose_from_transform, transform
from grasp_refine.geometry.mesh import load_mesh
from grasp_refine.grasps.formats.dexgraspnet import rotation_from_angles
from grasp_refine.grasps.formats.format import Format
from grasp_refine.grasps.formats.layout import Layout, layout_of
from grasp_refine.grasps.formats.source import Source, missing_keys
from grasp_refine.grasps.formats.trajectories import frames_before_lift
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand

O6_JOINTS = ("thumb_cmc_yaw", "thumb_cmc_pitch", "index_mcp_pitch", "middle_mcp_pitch", "ring_mcp_pitch")
O6 = Layout("linkerhand_o6_right", "rh_hand_base_link", tuple(f"rh_{name}" for name in (*O6_JOINTS, "pinky_mcp_pitch")))
"""LinkerHand O6, right: the driven joints; the others follow them."""
FOLDERS = ("*meshdata*", "assets/*meshdata*")
"""Folders of meshes, in a folder above the trajectories."""
MESH = "coacd/decomposed.obj"
"""The mesh in the folder of an object."""
MAX_FOLDERS_UP = 3
"""Number of folders above a file in which its mesh is sought."""


@dataclass(frozen=True)
class GraspM3(Format):
    """Files `object.npy`; of each trajectory the last frame before the lift is read."""

    name: str = "graspm3"
    what: str = "GraspM3 and its Motion Challenge: an .npy of trajectories per object, LinkerHand O6; read only"
    named_by_path: bool = True

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        return missing_keys(content, ("grasp_seqs", "obj_rotmat", "obj_scale"))

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of a file, one per trajectory."""
        held, name = source.content, source.path.stem
        seqs = source.moderate(held["grasp_seqs"], "grasp_seqs", (None, None, None))
        count = len(seqs)
        layout = layout_of(source, (O6,), seqs.shape[2] - 6, hand)
        T_world_object = np.tile(np.eye(4), (count, 1, 1))
        T_world_object[:, :3, :3] = source.moderate(held["obj_rotmat"], "obj_rotmat", (count, 3, 3))
        T_world_object = source.transforms(T_world_object, "obj_rotmat")
        factors = source.moderate(held["obj_scale"], "obj_scale", (count,))
        scale = np.array([source.scale(value, "obj_scale") for value in factors])
        vertices = self._vertices(source, name)
        T_world_object[:, 2, 3] = -(T_world_object[:, 2, :3] @ vertices.T).min(axis=1) * scale
        frames = frames_before_lift(seqs[:, :, :3])
        grasp = seqs[np.arange(count), frames]
        # Rotated axes x, y, z are the fixed axes z, y, x: the transpose of the rotation by the opposite angles.
        R = rotation_from_angles(-grasp[:, 3:6]).swapaxes(1, 2)
        T = inverse(T_world_object) @ transform(R, grasp[:, :3])
        grasps = layout.grasps(hand, pose_from_transform(T), grasp[:, 6:], object=name, scale=scale)
        middle, last = int(np.median(frames)), seqs.shape[1] - 1
        return grasps, [
            f"of each trajectory the last frame before the lift is taken, {middle} of {last} at the median; its joint "
            "values are set points, which press into the object"
        ]

    def _vertices(self, source: Source, name: str) -> Float[np.ndarray, "V 3"]:
        """Points of the object's mesh, which stands on the table."""
        for folder in source.path.absolute().parents[: MAX_FOLDERS_UP + 1]:
            if source.within is not None and not folder.is_relative_to(source.within.absolute()):
                break
            for place in (place for pattern in FOLDERS for place in sorted(folder.glob(pattern))):
                if is_file(place / name / MESH):
                    try:
                        return np.asarray(load_mesh(place / name / MESH).vertices)
                    except MeshError as error:
                        raise source.error(f"its object stands on a table, and has no usable mesh: {error}") from None
        raise source.error(
            f"the object stands on a table, at a height that only its mesh gives: put it at meshdata/{name}/{MESH} in "
            f"the folder of this file or one of the {MAX_FOLDERS_UP} above"
        )
