"""MultiDex of GenDexGrasp: one .pt file of many objects, rows of x y z, six numbers of the rotation, and joints.

A row is the pose of the root link of the hand's URDF in the object's frame: metres, then the first two columns of the
rotation. Objects have their own size, so that their scale is 1. The joints come in the order of the URDF from the root
outwards, which the file does not name; it is known here for the hands whose URDF a public copy of the data shows.

Source: github.com/tengyu-liu/GenDexGrasp, vis_multidex.py, utils_data/CMapDataset.py, utils_model/HandModel.py and
envs/tasks/grasp_test_force_shadowhand.py; the URDFs of its data in github.com/GeorgeWuzy/CEDex-Grasp.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import pose_from_transform, transform, transform_from_pose
from grasp_refine.grasps.formats.format import SINGLE_PRECISION, Format, Load, Part, omission_notes
from grasp_refine.grasps.formats.layout import ALLEGRO, LEAP, SHADOW_FINGERS, SHADOW_THUMB, Layout, check_hand, is_of
from grasp_refine.grasps.formats.source import Source, missing_keys
from grasp_refine.grasps.formats.stages import fit_layout, root_poses
from grasp_refine.grasps.grasp_set import GraspSet
from grasp_refine.hands.hand import Hand

BARRETT = ("bh_j32_joint", "bh_j33_joint") + tuple(f"bh_j{finger}{n}_joint" for finger in (1, 2) for n in (1, 2, 3))
ROBOTIQ = tuple(f"gripper_fingerA_joint_{n}" for n in (2, 3, 4))
ROBOTIQ += tuple(f"gripper_finger{f}_{n}" for f in "BC" for n in ("knuckle", "joint_2", "joint_3", "joint_4"))
ROBOTS = {
    "shadowhand": Layout("shadow", "forearm", ("WRJ2", "WRJ1") + SHADOW_FINGERS + SHADOW_THUMB),
    "allegro": Layout("allegro", "base_link", ALLEGRO),
    "barrett": Layout("bhand", "bh_base_link", BARRETT),
    "robotiq_3finger": Layout("robotiq_3finger", "palm_base", ROBOTIQ),
    "leaphand": Layout("leap", "palm_lower", LEAP),
}
"""Name of a hand in the file -> its joints and root."""
NUM_POSE_COLUMNS = 9
Entries = Sequence[tuple[np.ndarray, str, str]]
"""Row, object and robot of each grasp."""


@dataclass(frozen=True)
class MultiDex(Format):
    """Files such as `MultiDex/shadowhand/shadowhand.pt`: `metadata`, a list of (row, object, robot)."""

    name: str = "multidex"
    what: str = "MultiDex of GenDexGrasp: one .pt file, rows of pose and joints"

    def mismatch(self, content: Any) -> str:
        """Reason why contents are not of this format; "" if they are."""
        return mismatch_of_metadata(content, ROBOTS, NUM_POSE_COLUMNS)

    def read(self, source: Source, hand: Hand | None) -> tuple[GraspSet, Sequence[str]]:
        """The grasps of a file."""
        return grasps_of_entries(source, entries_of_metadata(source), ROBOTS, hand, NUM_POSE_COLUMNS, _transforms)

    def write(self, grasps: GraspSet, load: Load) -> tuple[Sequence[Part], Sequence[str]]:
        """One file."""
        return parts_of_entries(grasps, load, ROBOTS, self.name, _columns)


def _transforms(rows: Float[np.ndarray, "N 9"]) -> Float[np.ndarray, "N 4 4"]:
    """Poses of rows; where the two columns are not orthogonal, both are turned by as much, as GenDexGrasp does."""

    def unit(vectors: np.ndarray) -> np.ndarray:
        return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)

    with np.errstate(all="ignore"):
        first, second = unit(rows[:, 3:6]), unit(rows[:, 6:9])
        middle, across = unit(first + second), unit(first - second)
        x, y = unit(middle + across), unit(middle - across)
        return transform(np.stack([x, y, np.cross(x, y)], axis=-1), rows[:, :3])


def _columns(T: Float[np.ndarray, "N 4 4"]) -> Float[np.ndarray, "N 9"]:
    return np.concatenate([T[:, :3, 3], T[:, :3, 0], T[:, :3, 1]], axis=1)


def mismatch_of_metadata(content: Any, robots: Mapping[str, Layout], pose_columns: int) -> str:
    """Reason why contents are no `metadata` of rows with some numbers of a pose; "" if they are."""
    lacking = missing_keys(content, ("metadata",))
    if lacking:
        return lacking
    listed = content["metadata"]
    if not (isinstance(listed, list | tuple) and listed and isinstance(listed[0], list | tuple)):
        return "its metadata is no list of grasps"
    texts = [part for part in listed[0] if isinstance(part, str)]
    rows = [part for part in listed[0] if isinstance(part, np.ndarray) and part.ndim == 1]
    if not rows or not texts:
        return "its metadata has no row of numbers with an object"
    known = robots.get(texts[-1])
    wanted = None if known is None else pose_columns + len(known.joints)
    if wanted is not None and len(rows[-1]) != wanted:
        return f"its rows of {texts[-1]} have {len(rows[-1])} numbers, not {wanted}"
    return ""


def entries_of_metadata(source: Source) -> Entries:
    """Row, object and robot of each entry of `metadata`; contact maps before the rows are not read.

    Raises:
        GraspFileError: an entry of another form.
    """
    entries = []
    info = source.content.get("info")
    for at, entry in enumerate(source.content["metadata"]):
        texts = [part for part in entry if isinstance(part, str)] if isinstance(entry, list | tuple) else []
        rows = [part for part in entry if isinstance(part, np.ndarray) and part.ndim == 1] if texts else []
        if not rows or len(texts) > 2:
            raise source.error(f"metadata[{at}] must be a row of numbers, an object and a hand")
        said = info.get("robot_name") if isinstance(info, Mapping) else None
        robot = texts[1] if len(texts) == 2 else said if isinstance(said, str) else source.path.stem
        entries.append((rows[-1], source.text(texts[0], f"object of metadata[{at}]"), robot))
    return entries


def grasps_of_entries(
    source: Source,
    entries: Entries,
    robots: Mapping[str, Layout],
    hand: Hand | None,
    pose_columns: int,
    transforms: Callable[[np.ndarray], np.ndarray],
    labels: Mapping[str, Sequence[float]] | None = None,
) -> tuple[GraspSet, Sequence[str]]:
    """The grasps of the one hand in a file, or of that which the user gave, with `labels` of the entries, and notes.

    Raises:
        GraspFileError: several hands, one whose joints are not known, or rows of another length.
    """
    counts = Counter(robot for _, _, robot in entries)
    listing = ", ".join(f"{robot} ({count})" for robot, count in counts.items())[:400]
    wanted = [robot for robot in counts if hand is None or (robot in robots and is_of(robots[robot], hand))]
    if len(wanted) > 1:
        raise source.error(f"holds grasps of several hands, choose one with `hand`: {listing}")
    robot = wanted[0] if wanted else next(iter(counts))
    layout = robots.get(robot)
    if layout is None:
        known = "; ".join(f"{name}: {', '.join(known.joints)}" for name, known in robots.items())
        raise source.error(
            f"is for the hand '{robot[:40]}' and names no joints; their order is known for {known}; give grasps with "
            "joint names, such as our own .npz"
        )
    check_hand(source, layout, hand)
    count = pose_columns + len(layout.joints)
    of_hand = [(row, thing) for row, thing, of in entries if of == robot]
    odd = [len(row) for row, _ in of_hand if len(row) != count]
    if odd:
        raise source.error(
            f"rows of {robot} must have {count} numbers, {pose_columns} of them a pose; one has {odd[0]}"
        )
    rows = source.numbers(np.array([row for row, _ in of_hand]), f"rows of {robot}", (None, count))
    things = np.array([thing for _, thing in of_hand])
    poses = pose_from_transform(transforms(rows[:, :pose_columns]) @ layout.T_root_base)
    of_hand_only = {
        name: source.numbers(list(compress(values, (of == robot for _, _, of in entries))), name)
        for name, values in (labels or {}).items()
    }
    grasps = layout.grasps(hand, poses, rows[:, pose_columns:], object=things, labels=of_hand_only)
    notes = [f"joints are in the order of the URDF of {robot}, which the file does not name"]
    if len(counts) > 1:
        notes.append(f"of several hands, grasps of {robot} are read: {listing}")
    return grasps, notes


def parts_of_entries(
    grasps: GraspSet,
    load: Load,
    robots: Mapping[str, Layout],
    name: str,
    columns: Callable[[np.ndarray], np.ndarray],
) -> tuple[Sequence[Part], Sequence[str]]:
    """One .pt file with `info` and `metadata`, in single precision, and notes on data without a place in it.

    Raises:
        GraspFileError: a hand that is not known.
    """
    moved, layout = fit_layout(grasps, tuple(robots.values()), load, name)
    (robot,) = [robot for robot, known in robots.items() if known == layout]
    T_object_root = transform_from_pose(root_poses(moved, layout))
    rows = np.concatenate([columns(T_object_root), moved.q], axis=1).astype(np.float32)
    things = grasps.object.tolist()
    per_object = Counter(things)
    info = {
        "robot_name": robot,
        "num_total": len(things),
        "num_upper_object": max(per_object.values()),
        "num_per_object": dict(per_object),
    }
    metadata = [(row, thing, robot) for row, thing in zip(rows, things, strict=True)]
    content = {"info": {robot: info}, "metadata": metadata}
    lost = omission_notes(grasps, layout.joints, stages=False, size="meshes are in metres")
    return [Part("grasps.pt", np.arange(len(things)), content)], [SINGLE_PRECISION, *lost]


def left(layout: Layout) -> Layout:
    """Return the layout of the left hand with the same joints."""
    return replace(layout, hand=f"{layout.hand}_left")
