"""BODex's own files: the grasps of one object, `robot_pose` (1, N, 3, 7 + n), Shadow with the thumb first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from grasp_refine.grasps.formats.folders import floating_folder
from grasp_refine.grasps.formats.format import Format, Load, Part, omission_notes, rows_by_object
from grasp_refine.grasps.formats.layout import BODEX
from grasp_refine.grasps.formats.scene import object_in_scene
from grasp_refine.grasps.formats.source import Source, missing_keys
from grasp_refine.grasps.formats.stages import (
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
class Bodex(Format):
    """Files `*_grasp.npy` that BODex writes; `joint_names` are used where present.

    The object is `obj_pose`, `obj_scale` and `obj_path`, each a list of one, or in the file that `scene_path` names.
    """

    name: str = "bodex"
    what: str = "BODex: a folder of .npy files, each with all grasps of one object and scale, in three stages"

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        return missing_keys(content, ("robot_pose",))

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of a file."""
        held = source.content
        poses = source.numbers(held["robot_pose"], "robot_pose", (None, None, None, None))
        if poses.shape[0] != 1 or poses.shape[2] != len(STAGES) or poses.shape[3] < 8:
            raise source.error(
                f"robot_pose must have shape (1, N, 3, 7 + joints): one object, N grasps, {', '.join(STAGES)}; it has "
                f"{poses.shape} (motions of a hand on an arm are not read)"
            )
        notes: Sequence[str] = ()
        if missing_keys(held, ("obj_pose", "obj_scale", "obj_path")):
            described, notes = object_in_scene(source)
        else:
            described = {
                "object_pose": source.numbers(held["obj_pose"], "obj_pose").ravel()[:7],
                "object_name": source.object_name(_first(held["obj_path"]), "obj_path"),
                "scale": source.scale(_first(held["obj_scale"]), "obj_scale"),
            }
        rows = {f"{name} of robot_pose": poses[0, :, at] for at, name in enumerate(STAGES)}
        return grasps_of_stages(source, BODEX, hand, rows, **described), notes

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """One file per object and scale."""
        moved, layout = fit_layout(grasps, BODEX, load, self.name)
        poses = np.stack([rows_of_stage(moved, name, layout) for name in STAGES], axis=1)
        number: Counter[str] = Counter()
        parts = []
        for (name, scale), rows in rows_by_object(grasps).items():
            path = floating_folder(name, scale)
            number[path] += 1
            content = {
                "robot_pose": poses[None, rows],
                "joint_names": list(layout.joints),
                "obj_pose": ORIGIN_POSE[None].copy(),
                "obj_scale": np.array([scale]),
                "obj_path": [f"assets/object/{name}/mesh/simplified.obj"],
            }
            again = f"_{number[path]}" if number[path] > 1 else ""
            parts.append(Part(f"{path}{again}_grasp.npy", rows, content))
        return parts, [*missing_stage_notes(grasps), *omission_notes(grasps, layout.joints)]


def _first(value: Any) -> Any:
    listed = isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim > 0)
    return value[0] if listed and len(value) else value
