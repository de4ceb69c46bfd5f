"""EquiDexFlow: a .json file per hand and object, `HAND/OBJECT.json`, with grasps, contacts and qualities; read only.

A pose is that of the root link of its hand file in the object's frame. Source: `data/README.md`, `allegro_fk.py` and
`leap.py` of coenwerem/equidexflow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.grasps.formats.format import Format
from grasp_refine.grasps.formats.layout import ALLEGRO, LEAP, Layout, layout_of
from grasp_refine.grasps.formats.source import Source, missing_keys
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand

LAYOUTS = (
    Layout("allegro", "base_link", ALLEGRO, (0.0, 0.0, 0.095, 1.0, 0.0, 0.0, 0.0)),
    Layout("leap", "palm_lower", LEAP, (0.0, 0.038, 0.098, 1.0, 0.0, -1.0, 0.0)),
)
"""Right hands, in the order of Drake: `algr_rh_palm` and `leap_hand_base` are the roots."""
QUALITIES = {"epsilon_quality": "epsilon_quality", "volume_quality": "volume_quality"}
"""Key of a grasp -> label."""


@dataclass(frozen=True)
class EquiDexFlow(Format):
    """Files with `grasps`, each a dict with `hand_dof_values` and `wrist_pose_object`."""

    name: str = "equidexflow"
    what: str = "EquiDexFlow: a .json per hand and object, HAND/OBJECT.json; read only"
    named_by_path: bool = True

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        lacking = missing_keys(content, ("object_name", "grasps"))
        if lacking:
            return lacking
        grasps = content["grasps"]
        if not (isinstance(grasps, list) and grasps and all(isinstance(grasp, Mapping) for grasp in grasps)):
            return "its grasps are no list of dicts"
        return missing_keys(grasps[0], ("hand_dof_values",))

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of a file."""
        grasps = source.content["grasps"]
        for row, grasp in enumerate(grasps):
            lacking = missing_keys(grasp, ("hand_dof_values", "wrist_pose_object"))
            if lacking:
                raise source.error(f"grasp {row}: {lacking}, so that its pose or joints are unknown")
        q = source.numbers([grasp["hand_dof_values"] for grasp in grasps], "hand_dof_values", (None, None))
        folder = source.path.absolute().parent.name
        layout = layout_of(source, LAYOUTS, q.shape[1], hand, hand_name=folder)
        T = source.transforms([grasp["wrist_pose_object"] for grasp in grasps], "wrist_pose_object", len(q))
        labels = {
            label: source.numbers([grasp[key] for grasp in grasps], key, (len(q),))
            for key, label in QUALITIES.items()
            if all(key in grasp for grasp in grasps)
        }
        name = source.object_name(source.content["object_name"], "object_name")
        found = layout.grasps(hand, pose_from_transform(T @ layout.T_root_base), q, object=name, labels=labels)
        return found, ["contacts and their normals are not read"]
