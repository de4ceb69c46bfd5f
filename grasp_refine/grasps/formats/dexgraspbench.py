"""DexGraspBench: one grasp an .npy file, a dict of `obj_pose`, `obj_scale`, `obj_path` and three stages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from grasp_refine.grasps.formats.folders import object_folder, scale_folder
from grasp_refine.grasps.formats.format import Format, Load, Part, omission_notes, single_grasps
from grasp_refine.grasps.formats.hugs import is_hugs
from grasp_refine.grasps.formats.layout import MUJOCO
from grasp_refine.grasps.formats.source import Source, missing_keys
from grasp_refine.grasps.formats.stages import (
    GRASP,
    ORIGIN_POSE,
    STAGES,
    fit_layout,
    grasps_of_stages,
    missing_stage_notes,
    rows_of_stage,
)
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand


@dataclass(frozen=True)
class DexGraspBench(Format):
    """Files for DexGraspBench, such as `object/scale006_pose000/0.npy`; `joint_names` are used where present."""

    name: str = "dexgraspbench"
    what: str = "DexGraspBench: a folder of .npy files, each one grasp with pregrasp and squeeze"

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        if is_hugs(content):
            return "it is a record of HUGS"
        return missing_keys(content, ("grasp_qpos", "obj_pose", "obj_scale", "obj_path"))

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasp of a file."""
        held = source.content
        keys = [f"{name}_qpos" for name in STAGES if name == GRASP or held.get(f"{name}_qpos") is not None]
        rows = {key: source.numbers(held[key], key, (None,))[None] for key in keys}
        grasps = grasps_of_stages(
            source,
            MUJOCO,
            hand,
            rows,
            object_pose=held["obj_pose"],
            object_name=source.object_name(held["obj_path"], "obj_path"),
            scale=source.scale(held["obj_scale"], "obj_scale"),
        )
        return grasps, ()

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """One file per grasp."""
        moved, layout = fit_layout(grasps, MUJOCO, load, self.name)
        stages = {f"{name}_qpos": rows_of_stage(moved, name, layout) for name in STAGES}
        parts = []
        for row, name, scale, place in single_grasps(grasps, _folder):
            content = {
                "obj_pose": ORIGIN_POSE.copy(),
                "obj_scale": scale,
                "obj_path": f"assets/object/{name}",
                "joint_names": list(layout.joints),
                **{key: rows[row].copy() for key, rows in stages.items()},
            }
            parts.append(Part(f"{place}.npy", np.array([row]), content))
        return parts, [*missing_stage_notes(grasps), *omission_notes(grasps, layout.joints)]


def _folder(name: str, scale: float) -> str:
    return f"{object_folder(name)}/{scale_folder(scale)}_pose000"
