"""Lightning Grasp: the result of its pipeline, a dict of `q` (N, n) and `object_pose` (N, 4, 4), however it was saved.

Its demonstration writes no file: users save the dict, by torch.save, pickle, NumPy or as JSON. `object_pose` is the
pose of the object's mesh in the frame of the hand's root link, metres. The joints come in the order that its file of
the hand lists, not by name; the hand is named where users add a `robot_name`, the object where they add a `mesh_path`.

Source: github.com/zhaohengyin/lightning-grasp, demo.py and lygra/robot; for the names that users add github.com/
ian-chuang/lightning-grasp, generate_dataset.py; the URDFs in github.com/psycho811/lightning-grasp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from grasp_refine.core.se3 import inverse, pose_from_transform, transform_from_pose
from grasp_refine.grasps.formats.dro import LEAP_PALM
from grasp_refine.grasps.formats.folders import disambiguate, object_folder
from grasp_refine.grasps.formats.format import SINGLE_PRECISION, Format, Load, Part, omission_notes, rows_by_object
from grasp_refine.grasps.formats.layout import ALLEGRO, Layout, layout_of
from grasp_refine.grasps.formats.source import Source, missing_keys
from grasp_refine.grasps.formats.stages import fit_layout, root_poses
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand


def _tip_first(*fingers: tuple[str, int]) -> tuple[str, ...]:
    """Joints of Shadow fingers, each from the tip to the knuckle."""
    return tuple(f"{finger}J{number}" for finger, count in fingers for number in range(1, count + 1))


LAYOUTS = (
    Layout("shadow", "palm", _tip_first(("RF", 4), ("LF", 5), ("TH", 5), ("MF", 4), ("FF", 4))),
    Layout("allegro", "base_link", ALLEGRO),
    Layout("leap", "palm_lower", tuple(map(str, range(16))), LEAP_PALM),
    Layout("dclaw", "base", tuple(f"joint_f{finger}_{n}" for finger in (1, 2, 3) for n in range(3))),
)
MESH_NAMES = ("textured", "model", "mesh", "simplified", "decomposed")
"""Names of meshes that say nothing of the object: its folder does."""


@dataclass(frozen=True)
class LightningGrasp(Format):
    """Dicts of `q` and `object_pose`."""

    name: str = "lightning_grasp"
    what: str = "Lightning Grasp: one file per object, a dict of q and object_pose"

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        return missing_keys(content, ("q", "object_pose"))

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of a file."""
        held = source.content
        q = source.numbers(held["q"], "q", (None, None))
        T_hand_object = source.transforms(held["object_pose"], "object_pose", len(q))
        said = held.get("robot_name", held.get("robot"))
        named = "" if said is None else source.text(_first(said), "robot_name")
        layout = layout_of(source, LAYOUTS, q.shape[1], hand, hand_name=named)
        poses = pose_from_transform(inverse(T_hand_object) @ layout.T_root_base)
        grasps = layout.grasps(hand, poses, q, object=_object(source))
        return grasps, [f"joints are in the order of Lightning Grasp for {layout.hand}, which the file does not name"]

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """One .pt file per object, with the names of hand and object."""
        moved, layout = fit_layout(grasps, LAYOUTS, load, self.name)
        T_hand_object = inverse(transform_from_pose(root_poses(moved, layout)))
        groups = rows_by_object(grasps)
        files = disambiguate(object_folder(name) for name, _ in groups)
        parts = []
        for file, ((name, _), rows) in zip(files, groups.items(), strict=True):
            content = {
                "q": moved.q[rows].astype(np.float32),
                "object_pose": T_hand_object[rows].astype(np.float32),
                "robot_name": layout.hand,
                "mesh_path": f"assets/object/{name}/textured.obj",
            }
            parts.append(Part(f"{file}.pt", rows, content))
        lost = omission_notes(grasps, layout.joints, stages=False, size="meshes are in metres")
        return parts, [SINGLE_PRECISION, *lost]


def _first(value: Any) -> Any:
    """The value, or the first of a list of one for each grasp."""
    return value[0] if isinstance(value, list | tuple) and value else value


def _object(source: Source) -> str:
    """Name of the object."""
    path = source.content.get("mesh_path", source.content.get("object_mesh_path"))
    if path is None:
        return source.path.stem
    text = source.text(_first(path), "mesh_path")
    whole = PurePosixPath(text.replace("\\", "/"))
    folder = whole.parent if whole.stem in MESH_NAMES and len(whole.parts) > 1 else whole
    return source.object_name(folder.as_posix(), "mesh_path")
