"""D(R,O)-Grasp: .pt files with rows of x y z, three angles, and joints; the dataset, parts of it, and predictions.

A row holds the joints of a URDF with six virtual ones before the hand: the position of its root link in the object's
frame (metres), then turns about x, y and z, each about the already rotated axis: R = R_x R_y R_z. The
objects are MultiDex's, in their own size.

Source: github.com/zhenyuwei2003/DRO-Grasp, data_utils/filter_dataset.py, data_utils/CMapDataset.py, utils/rotation.py,
validation/isaac_main.py and validate.py; the URDFs of its data in github.com/object814/assembly, where `allegro` is a
left hand, and the root of `leaphand` lies above the palm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.se3 import transform
from grasp_refine.grasps.formats.dexgraspnet import angles_from_rotation, rotation_from_angles
from grasp_refine.grasps.formats.format import SUCCESS, Format, Load, Part
from grasp_refine.grasps.formats.leap_cache import NUM_COLUMNS as NUM_LEAP_COLUMNS
from grasp_refine.grasps.formats.leap_cache import LeapCache
from grasp_refine.grasps.formats.multidex import (
    ROBOTS as MULTIDEX_ROBOTS,
)
from grasp_refine.grasps.formats.multidex import (
    Entries,
    entries_of_metadata,
    grasps_of_entries,
    left,
    mismatch_of_metadata,
    parts_of_entries,
)
from grasp_refine.grasps.formats.source import Source
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand

LEAP_PALM = (0.0, 0.038, 0.098, 1.0, 0.0, -1.0, 0.0)
"""Pose of the LEAP hand's palm_lower in its root link: a quarter turn about -y."""
ROBOTS = MULTIDEX_ROBOTS | {
    "allegro": left(MULTIDEX_ROBOTS["allegro"]),
    "leaphand": replace(MULTIDEX_ROBOTS["leaphand"], base_pose=LEAP_PALM),
}
NUM_POSE_COLUMNS = 6
COLUMNS = {NUM_POSE_COLUMNS + len(layout.joints) for layout in ROBOTS.values()}
"""Lengths of rows."""


@dataclass(frozen=True)
class DRO(Format):
    """`cmap_dataset.pt` with `metadata`; `ROBOT/OBJECT_COUNT.pt`, one array; and lists of dicts with `predict_q`."""

    name: str = "dro"
    what: str = "D(R,O)-Grasp: one .pt file, rows of position, angles and joints"

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        if isinstance(content, np.ndarray):
            if content.ndim == 2 and content.shape[1] in COLUMNS and content.dtype.kind == "f" and len(content):
                return ""
            return f"it is no array of rows of {', '.join(map(str, sorted(COLUMNS)))} numbers"
        if isinstance(content, list):
            listed = content and all(isinstance(part, Mapping) and "predict_q" in part for part in content)
            return "" if listed else "it is no list of dicts with predict_q"
        return mismatch_of_metadata(content, ROBOTS, NUM_POSE_COLUMNS)

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of a file."""
        held = source.content
        more: list[str] = []
        labels = {}
        if isinstance(held, np.ndarray):
            entries = _entries_of_array(source)
        elif isinstance(held, list):
            entries, success = _entries_of_predictions(source)
            labels = {} if np.isnan(success).all() else {SUCCESS: success}
        else:
            entries = entries_of_metadata(source)
        grasps, notes = grasps_of_entries(source, entries, ROBOTS, hand, NUM_POSE_COLUMNS, _transforms, labels)
        if grasps.joint_names == ROBOTS["allegro"].joints and hand is not None and "left" not in hand.name:
            more.append("the Allegro hand of D(R,O)-Grasp is a left one")
        return grasps, [*notes, *more]

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """One file."""
        if set(grasps.joint_names) == set(ROBOTS["allegro"].joints) and "left" not in grasps.hand:
            raise GraspFileError(f"format {self.name} holds a left Allegro hand; these grasps are of '{grasps.hand}'")
        return parts_of_entries(grasps, load, ROBOTS, self.name, _columns)


def _entries_of_array(source: Source) -> Entries:
    """Rows of `ROBOT/OBJECT_COUNT.pt`."""
    robot, thing = source.path.absolute().parent.name, source.path.stem.rpartition("_")[0] or source.path.stem
    if robot not in ROBOTS:
        raise source.error(
            f"is an array {source.content.shape} as {DRO.name} has it, whose hand is the name of its folder; "
            f"{robot[:40]!r} is none of {', '.join(ROBOTS)}; an array of {LeapCache.name} is (N, {NUM_LEAP_COLUMNS})"
        )
    return [(row, thing, robot) for row in source.content]


def _entries_of_predictions(source: Source) -> tuple[Entries, list[float]]:
    """Rows of `vis_info`, and whether each succeeded, NaN where unknown."""
    entries: list[tuple[np.ndarray, str, str]] = []
    passed: list[float] = []
    for at, part in enumerate(source.content):
        robot, thing = (source.text(part.get(key), f"{key} of [{at}]") for key in ("robot_name", "object_name"))
        rows = source.numbers(part["predict_q"], f"predict_q of [{at}]", (None, None))
        entries += [(row, thing, robot) for row in rows]
        succeeded = part.get("success")
        success = np.full(len(rows), np.nan) if succeeded is None else np.asarray(succeeded).ravel()
        if success.dtype.kind not in "biuf" or len(success) != len(rows):
            raise source.error(f"success of [{at}] must have {len(rows)} entries, one per grasp; it has {len(success)}")
        passed += success.astype(float).tolist()
    return entries, passed


def _transforms(rows: Float[np.ndarray, "N 6"]) -> Float[np.ndarray, "N 4 4"]:
    # R_x(a) R_y(b) R_z(c) is the inverse of R_z(-c) R_y(-b) R_x(-a).
    return transform(rotation_from_angles(-rows[:, 3:]).swapaxes(-1, -2), rows[:, :3])


def _columns(T: Float[np.ndarray, "N 4 4"]) -> Float[np.ndarray, "N 6"]:
    return np.concatenate([T[:, :3, 3], -angles_from_rotation(T[:, :3, :3].swapaxes(-1, -2))], axis=1)
