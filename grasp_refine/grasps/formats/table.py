"""Any table of grasps: a TOML file names the columns of a CSV, Parquet or HDF5 file, or of a LeRobot data set."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.errors import quote_value
from grasp_refine.core.se3 import exp_so3, inverse, pose_from_transform, transform, transform_from_pose
from grasp_refine.grasps.formats.columns import column_names, load_columns
from grasp_refine.grasps.formats.dexgraspnet import rotation_from_angles
from grasp_refine.grasps.formats.format import Format
from grasp_refine.grasps.formats.source import Source, missing_keys
from grasp_refine.grasps.formats.trajectories import frames_before_lift
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Unit of length -> metres."""
RADIANS = {"rad": 1.0, "deg": np.pi / 180}
"""Unit of angle -> radians."""
ROTATIONS = {"wxyz": 4, "xyzw": 4, "rotvec": 3, "fixed_xyz": 3, "rotated_xyz": 3, "matrix": 9}
"""Notation of a rotation -> number of values."""
FRAMES = ("all", "last", "before_lift")
"""Rows of an episode that are grasps."""
KEYS = {
    "table": str, "hand": str, "base_link": str, "position": None, "rotation": None, "pose": None, "notation": str,
    "pose_of": str, "object_position": None, "object_rotation": None, "length_unit": str, "angle_unit": str,
    "joints": None, "joint_column": str, "joint_unit": str, "object": str, "object_column": str, "scale": float,
    "scale_column": str, "labels": dict, "episode": str, "frame": str,
}  # fmt: skip
"""Keys of the TOML file, and their types where they have one."""


@dataclass(frozen=True)
class Table(Format):
    """TOML files with a key `table`."""

    name: str = "table"
    what: str = (
        "any table: a .toml that names the columns of a CSV, Parquet or HDF5 file, or a LeRobot data set; read only"
    )
    named_by_path: bool = True

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        return missing_keys(content, ("table", "joints"))

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of the table that a file names."""
        mapping = _Mapping(source, source.content)
        joints = mapping.joints
        base_link = mapping.text("base_link", hand.base_link if hand else "")
        if not base_link:
            raise source.error("needs base_link, the link of its poses, or the hand with `hand`")
        T = mapping.transforms("position", "rotation", "pose")
        if mapping.choice("pose_of", ("hand", "object"), "hand") == "object":
            T = inverse(T)
        where = T
        if mapping.has("object_position") or mapping.has("object_rotation"):
            T = inverse(mapping.transforms("object_position", "object_rotation", "")) @ T
        rows, notes = mapping.rows(where[:, :3, 3])
        scale = mapping.column("scale_column") if mapping.has("scale_column") else mapping.number("scale", 1.0)
        q = mapping.values(list(joints.values()), len(joints)) if joints else np.zeros((len(T), 0))
        grasps = GraspSet(
            hand=hand.name if hand else mapping.text("hand", "hand"),
            base_link=base_link,
            joint_names=tuple(joints),
            object=mapping.objects(len(T))[rows],
            scale=np.array([source.scale(value, "scale") for value in np.broadcast_to(scale, len(T))[rows]]),
            hand_pose=pose_from_transform(T[rows]),
            q=q[rows] * RADIANS[mapping.choice("joint_unit", tuple(RADIANS), "rad")],
            labels={label: mapping.values([column], 1)[rows, 0] for label, column in mapping.labels.items()},
        )
        return grasps, notes


class _Mapping:
    """Keys of the TOML file, and the columns that they name."""

    def __init__(self, source: Source, held: Mapping[str, Any]) -> None:
        self.source, self.held = source, held
        unknown = [key for key in held if key not in KEYS]
        if unknown:
            raise source.error(f"has unknown keys {', '.join(map(str, unknown))}; the keys are {', '.join(KEYS)}")
        for key, value in held.items():
            kind = KEYS[key]
            if kind is not None and not isinstance(value, (int, float) if kind is float else kind):
                raise source.error(f"{key} must be a {kind.__name__}, got {quote_value(value)}")
        self.table = self._table()
        joints, listed = held["joints"], held.get("joint_column")
        if isinstance(joints, list) and all(isinstance(name, str) for name in joints):
            # One column of vectors, or columns named like the joints.
            joints = {name: (listed, at) if listed else name for at, name in enumerate(joints)}
        if not isinstance(joints, Mapping) or (listed and not isinstance(held["joints"], list)):
            raise source.error(
                "joints must be a table of joint = column, or a list of joints, with joint_column if any"
            )
        self.joints: dict[str, Any] = dict(joints)
        self.labels: dict[str, Any] = dict(held.get("labels", {}))
        wanted: list[Any] = [*self.joints.values(), *self.labels.values()]
        for key in ("position", "rotation", "pose", "object_position", "object_rotation"):
            wanted += held[key] if isinstance(held.get(key), list) else [held.get(key)]
        wanted += [held.get(key) for key in ("joint_column", "object_column", "scale_column", "episode")]
        names = [name[0] if isinstance(name, tuple) else name for name in wanted if name is not None]
        wrong = [name for name in names if not isinstance(name, str)]
        if wrong:
            raise source.error(f"columns are named by texts; got {quote_value(wrong[0])}")
        names = list(dict.fromkeys(names))
        self.columns = load_columns(self.table, names)
        lacking = [name for name in names if name not in self.columns]
        if lacking:
            known = ", ".join(column_names(self.table)[:50])
            raise source.error(f"names the columns {', '.join(lacking)}, which {self.table} lacks; it has {known}")
        lengths = {name: len(column) if column.ndim else 0 for name, column in self.columns.items()}
        if len({*lengths.values()}) != 1 or not min(lengths.values()):
            raise source.error(f"the columns of {self.table} differ in length, or are empty: {lengths}")

    def has(self, key: str) -> bool:
        """Return whether the file has a key."""
        return key in self.held

    def text(self, key: str, default: str) -> str:
        """Return a text."""
        return self.source.text(self.held.get(key, default), key)

    def number(self, key: str, default: float) -> float:
        """Return a number."""
        return float(self.held.get(key, default))

    def choice(self, key: str, choices: Sequence[str], default: str) -> str:
        """Return one of some texts."""
        value = self.held.get(key, default)
        if value not in choices:
            raise self.source.error(f"{key} must be one of {', '.join(choices)}, got {quote_value(value)}")
        return str(value)

    def column(self, key: str) -> np.ndarray:
        """Return the column that a key names."""
        return self.columns[self.held[key]]

    def values(self, names: Any, count: int) -> Float[np.ndarray, "N count"]:
        """Return numbers (N, count) of columns: one of vectors, or one each."""
        parts = []
        for name in names if isinstance(names, list) else [names]:
            column, at = name if isinstance(name, tuple) else (name, None)
            found = self.columns[column]
            found = found.astype(float) if found.dtype.kind == "b" else found
            found = found.reshape(len(found), -1)
            if at is not None and found.shape[1] != count:
                raise self.source.error(f"column {column} has {found.shape[1]} entries, and {count} joints are named")
            parts.append(self.source.moderate(found if at is None else found[:, [at]], f"column {column}"))
        joined = np.concatenate(parts, axis=1) if parts else np.zeros((0, 0))
        if joined.shape[1] != count:
            raise self.source.error(f"{names} have {joined.shape[1]} numbers per row; {count} are needed")
        return joined

    def transforms(self, position: str, rotation: str, pose: str) -> Float[np.ndarray, "N 4 4"]:
        """Return the transforms (N, 4, 4) that columns of position and rotation give, or those of a whole pose."""
        unit = METRES[self.choice("length_unit", tuple(METRES), "m")]
        notation = self.choice("notation", (*ROTATIONS, "transform"), "wxyz")
        if notation == "transform":
            if not pose or pose not in self.held:
                raise self.source.error("notation transform takes pose, a column of 16 numbers, row by row")
            T = self.values(self.held[pose], 16).reshape(-1, 4, 4)
            T[:, :3, 3] *= unit
            return self.source.transforms(T, pose)
        if pose and pose in self.held:
            both = self.values(self.held[pose], 3 + ROTATIONS[notation])
            p, r = both[:, :3], both[:, 3:]
        else:
            lacking = [key for key in (position, rotation) if key not in self.held]
            if lacking:
                raise self.source.error(f"lacks {' and '.join(lacking)}{f', or {pose}' if pose else ''}")
            p, r = self.values(self.held[position], 3), self.values(self.held[rotation], ROTATIONS[notation])
        p = p * unit
        if notation in ("wxyz", "xyzw"):
            r = r if notation == "wxyz" else np.roll(r, 1, axis=1)
            return transform_from_pose(self.source.poses(np.concatenate([p, r], axis=1), rotation))
        if notation == "matrix":
            T = np.tile(np.eye(4), (len(p), 1, 1))
            T[:, :3, :3], T[:, :3, 3] = r.reshape(-1, 3, 3), p
            return self.source.transforms(T, rotation)
        r = r * RADIANS[self.choice("angle_unit", tuple(RADIANS), "rad")]
        if notation == "rotvec":
            return transform(exp_so3(r), p)
        R = rotation_from_angles(r) if notation == "fixed_xyz" else rotation_from_angles(-r).swapaxes(1, 2)
        return transform(R, p)

    def objects(self, count: int) -> np.ndarray:
        """Return the names of the objects (N,)."""
        if not self.has("object_column"):
            return np.full(count, self.text("object", self.source.path.stem))
        found = self.column("object_column").ravel()
        texts = found if found.dtype.kind in "US" else [f"{value:g}" for value in self.source.finite(found, "object")]
        return np.array([self.source.object_name(str(value), "object_column") for value in texts])

    def rows(self, position: Float[np.ndarray, "N 3"]) -> tuple[Int[np.ndarray, " M"], list[str]]:
        """Return the rows that are grasps, one per episode where there are episodes, and notes."""
        frame = self.choice("frame", FRAMES, "all" if not self.has("episode") else "last")
        if frame == "all":
            return np.arange(len(position)), []
        if not self.has("episode"):
            raise self.source.error(f"frame = {frame!r} takes episode, the column that numbers the episodes")
        episodes = self.column("episode")
        if episodes.dtype.kind not in "US":
            episodes = self.source.finite(episodes, f"column {self.held['episode']}")
        if episodes.ndim != 1:
            raise self.source.error(f"column {self.held['episode']} must have one value per row")
        found = []
        for value in dict.fromkeys(episodes.tolist()):
            rows = np.flatnonzero(episodes == value)
            chosen = len(rows) - 1 if frame == "last" else int(frames_before_lift(position[None, rows])[0])
            found.append(rows[chosen])
        what = "last row" if frame == "last" else "last row before the lift"
        return np.array(found), [f"of each of {len(found)} episodes the {what} is taken"]

    def _table(self) -> Path:
        """Path of the table, in the folder of the TOML file or below it."""
        name = self.text("table", "")
        # Links are followed: caches of downloads have nothing else.
        path = Path(os.path.normpath(self.source.path.absolute().parent / name))
        if not path.is_relative_to((self.source.within or self.source.path.parent).absolute()):
            raise self.source.error(f"table must lie in the folder of this file or below it, got {name!r}")
        return path
