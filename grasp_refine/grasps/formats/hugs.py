"""HUGS: records of HUGS-DexGraspBench, DexGraspBench's keys with a version; one grasp of one hand an .npy file.

The pose is the pose of the palm itself; DexGraspBench has it before the palm; `joint_names` are required, with rh_ in
front. The hands are Shadow, and LEAP with other fingertips than ours. Records of two hands have joints of dummy arms
instead of poses, and are refused. What BODex writes for HUGS is of the format bodex.

Source: github.com/hugs-dex/HUGS-DexGraspBench, docs/contracts.md, src/task/convert_format.py, src/util/hand_util.py and
the MJCF files in assets/hand; github.com/hugs-dex/HUGS-Main, docs/data.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from grasp_refine.grasps.formats.folders import floating_folder
from grasp_refine.grasps.formats.format import Format, Load, Part, omission_notes, single_grasps
from grasp_refine.grasps.formats.layout import BODEX
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

VERSION_KEY, VERSION = "bench_contract_version", "1.0"
PREFIXES = {"shadow": "rh_", "leap": "rh_joint_"}
"""Our hand -> what its joints have in front."""
LAYOUTS = tuple(layout for layout in BODEX if layout.hand in PREFIXES)
OTHER_JOINTS = ("lh_", "la_", "ra_")
"""Starts of the names of joints of a left hand, and of dummy arms."""
ROOT = "HUGS_DATASET_ROOT"
"""Folder of paths in a record; formerly ANYSCALEGRASP_DATA_ROOT."""


def is_hugs(content: Any) -> bool:
    """Return True for a record with the version of HUGS."""
    return isinstance(content, Mapping) and VERSION_KEY in content


@dataclass(frozen=True)
class Hugs(Format):
    """Files `*_grasp.npy` after `task=format`, and after evaluation."""

    name: str = "hugs"
    what: str = "HUGS: a folder of .npy files, each one grasp with pregrasp and squeeze, of one hand"

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        return missing_keys(content, (VERSION_KEY, "grasp_qpos", "obj_pose", "obj_scale", "obj_path"))

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasp of a file."""
        held = source.content
        version = source.text(held[VERSION_KEY], VERSION_KEY)
        if version != VERSION:
            raise source.error(f"is of {VERSION_KEY} {version[:20]!r}; {VERSION} is read")
        names = source.joint_names(held)
        if not names:
            raise source.error("lacks joint_names, which give the order of its joints")
        others = [name for name in names if name.startswith(OTHER_JOINTS)]
        if others:
            raise source.error(f"is of two hands, with the joints {', '.join(others[:4])}, ...; grasps of one are read")
        renamed = [name.removeprefix("rh_").removeprefix("joint_") for name in names]
        keys = [f"{name}_qpos" for name in STAGES if name == GRASP or held.get(f"{name}_qpos") is not None]
        grasps = grasps_of_stages(
            replace(source, content={**held, "joint_names": renamed}),
            LAYOUTS,
            hand,
            {key: source.numbers(held[key], key, (None,))[None] for key in keys},
            object_pose=held["obj_pose"],
            object_name=source.object_name(held["obj_path"], "obj_path"),
            scale=source.scale(held["obj_scale"], "obj_scale"),
        )
        notes = ["succ_flag has no place in a grasp set"] if "succ_flag" in held else []
        if any(layout.hand == "leap" and set(grasps.joint_names) == set(layout.joints) for layout in LAYOUTS):
            notes.append("its LEAP hand has other fingertips than ours")
        return grasps, notes

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """One file per grasp."""
        moved, layout = fit_layout(grasps, LAYOUTS, load, self.name)
        stages = {f"{name}_qpos": rows_of_stage(moved, name, layout) for name in STAGES}
        prefix = next(PREFIXES[known.hand] for known in LAYOUTS if known.joints == layout.joints)
        parts = []
        for row, name, scale, place in single_grasps(grasps, floating_folder):
            content = {
                VERSION_KEY: VERSION,
                "path_root": ROOT,
                "obj_path": f"object/{name}",
                "obj_pose": ORIGIN_POSE.copy(),
                "obj_scale": scale,
                "scene_path": "",
                "joint_names": [f"{prefix}{joint}" for joint in layout.joints],
                **{key: rows[row].copy() for key, rows in stages.items()},
            }
            parts.append(Part(f"{place}_grasp.npy", np.array([row]), content))
        notes = [*missing_stage_notes(grasps), "there is no scene: scene_path is empty"]
        return parts, [*notes, *omission_notes(grasps, layout.joints)]
