"""Dexonomy: one grasp an .npy file, a dict of stages, a scene and contacts; with its current or its former keys."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from grasp_refine.grasps.formats.folders import floating_folder
from grasp_refine.grasps.formats.format import Format, Load, Part, omission_notes, single_grasps
from grasp_refine.grasps.formats.layout import MUJOCO
from grasp_refine.grasps.formats.scene import object_in_scene
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

FORMER_KEYS = {"hand_type": "hand_name", "hand_template_name": "tmpl_name", "evolution_num": "n_evo"}
"""Former keys -> current ones (`dexonomy/op/gen_grasp.py` of JYChen18/Dexonomy)."""


@dataclass(frozen=True)
class Dexonomy(Format):
    """Files of Dexonomy: stages are rows (1, 7 + n), or (7 + n,) with former keys; of several pregrasps the first."""

    name: str = "dexonomy"
    what: str = "Dexonomy: a folder of .npy files, each one grasp with its scene"

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        lacking = missing_keys(content, ("grasp_qpos",))
        if lacking:
            return lacking
        held = _renamed(content)
        if "n_evo" not in held:
            return f"it lacks n_evo (formerly {next(old for old, new in FORMER_KEYS.items() if new == 'n_evo')})"
        return "" if "scene_path" in held or "scene_cfg" in held else "it lacks scene_path or scene_cfg"

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasp of a file."""
        held = _renamed(source.content)
        notes: list[str] = []
        rows = {}
        for name in STAGES:
            value = held.get(f"{name}_qpos")
            if value is None and name != GRASP:
                continue
            value = source.numbers(value, f"{name}_qpos")
            value = value[None] if value.ndim == 1 else value
            if name == STAGES[0] and value.ndim == 2 and len(value) > 1:
                notes.append("of several pregrasps of a grasp the first, with the hand open the most, is taken")
                value = value[:1]
            if value.ndim != 2 or len(value) != 1:
                raise source.error(f"{name}_qpos must hold one grasp; it has shape {value.shape}")
            rows[f"{name}_qpos"] = value
        named = source.text(held["hand_name"], "hand_name") if held.get("hand_name") is not None else ""
        described, more = object_in_scene(source)
        return grasps_of_stages(source, MUJOCO, hand, rows, hand_name=named, **described), [*notes, *more]

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """One file per grasp, with its scene inside."""
        moved, layout = fit_layout(grasps, MUJOCO, load, self.name)
        stages = {f"{name}_qpos": rows_of_stage(moved, name, layout) for name in STAGES}
        parts = []
        for row, name, scale, place in single_grasps(grasps, floating_folder):
            thing = {
                "type": "rigid_object",
                "file_path": f"assets/object/{name}/mesh/simplified.obj",
                "pose": ORIGIN_POSE.copy(),
                "scale": np.full(3, scale),
            }
            content = {
                "hand_name": layout.hand,
                "tmpl_name": "",
                "n_evo": np.zeros(1),
                "scene_cfg": {"scene": {name: thing}, "task": {"type": "force_closure", "obj_name": name}},
                **{key: rows[row : row + 1].copy() for key, rows in stages.items()},
            }
            parts.append(Part(f"{place}_grasp.npy", np.array([row]), content))
        contacts = "contacts are not written: Dexonomy's own are of its generator"
        return parts, [*missing_stage_notes(grasps), *omission_notes(grasps, layout.joints), contacts]


def _renamed(content: Mapping[str, Any]) -> dict[str, Any]:
    return {FORMER_KEYS.get(key, key): value for key, value in content.items()}
