"""Records of grasp files beside the grasps: poses before refinement and measures, row by row."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from grasp_refine.core.array_types import Float, Shaped
from grasp_refine.core.npz_files import NpzFile, load_npz
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import GraspSet, Stage, load_grasps, match_joints
from grasp_refine.grasps.poses import unit_poses
from grasp_refine.problem.problem import Problem
from grasp_refine.results.certificate import CERTIFICATE
from grasp_refine.results.result_numbers import numbers_of
from grasp_refine_apps.viewer.model.columns import FAILED_TEXT, HELD_TEXT, OF_REFINEMENT, VERDICTS, numeric_columns

BEFORE = ("hand_pose_before", "q_before")
"""Entries of result files that hold poses and joint values before refinement."""
BEFORE_OF_VERSION_0_1 = ("initial_pose", "initial_q")
"""Their names in results of version 0.1."""


@dataclass(frozen=True, eq=False)
class Records:
    """Records of all R rows of the files of a problem."""

    file: Shaped[np.ndarray, " R"]
    """Number of the file in `files` (R,)."""
    row: Shaped[np.ndarray, " R"]
    """Row in that file (R,)."""
    files: tuple[Path, ...]
    """Files that have rows."""
    columns: dict[str, Shaped[np.ndarray, " R"]]
    """Key of a measure -> its values (R,), NaN or empty where unknown."""
    T: Float[np.ndarray, "R 4 4"]
    """Poses of the base link before refinement, object frame; NaN where none is recorded."""
    q: Float[np.ndarray, "R n"]
    """Joint values before refinement, in the order of the hand; NaN where none are recorded."""


def read_records(problem: Problem) -> Records | None:
    """Read the records of the files of a problem; None where its grasps are no rows of our grasp files.

    Raises:
        GraspFileError: a result file is damaged.
    """
    files = row_files(problem)
    if not files:
        return None
    loaded = [load_npz(path) for path in files]
    if not all("hand_pose" in file.entries for file in loaded):
        return None
    counts = [len(file.numbers("hand_pose", allowed="any")) for file in loaded]
    if sum(counts) <= max(int(group.rows.max()) for group in problem.groups):
        return None
    columns = [_columns(file, count) for file, count in zip(loaded, counts, strict=True)]
    T, q = zip(*(_initial(file, count, problem) for file, count in zip(loaded, counts, strict=True)), strict=True)
    return Records(
        file=np.repeat(np.arange(len(counts)), counts),
        row=np.concatenate([np.arange(count) for count in counts]),
        files=files,
        columns={key: np.concatenate([part[key] for part in columns]) for key in columns[0]},
        T=np.concatenate(T),
        q=np.concatenate(q),
    )


def row_files(problem: Problem) -> tuple[Path, ...]:
    """Return the .npz files whose rows, one file after the other, are numbered by `Group.rows`."""
    if problem.sampled or not problem.files:
        return ()
    first, *others = problem.files
    files = tuple(path for path in others if path.is_relative_to(first)) if first.is_dir() else (first,)
    return files if all(path.suffix == ".npz" for path in files) else ()


def _columns(file: NpzFile, count: int) -> dict[str, np.ndarray]:
    """Read the measures of one file; each has a value for each of its rows, known or not."""
    texts = {column.key: np.full(count, "") for column in OF_REFINEMENT}
    columns = {column.key: np.full(count, np.nan) for column in numeric_columns()} | texts
    # In files without provenance, entries of these names may mean anything.
    if "provenance" in file.entries:
        for key in set(columns) & set(file.entries):
            value = file.text(key) if key in texts else file.numbers(key, allowed="nan")
            columns[key] = file.per_row(key, value, count)
    for column in VERDICTS:
        known = CERTIFICATE in file.entries
        held = numbers_of(file, column.key, count) if known else np.full(count, np.nan)
        columns[column.key] = np.select([held == 1.0, held == 0.0], [HELD_TEXT, FAILED_TEXT], "")
    return columns


def _initial(file: NpzFile, count: int, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Poses (R, 4, 4) and joint values (R, n) before refinement, NaN where the file has none."""
    hand = problem.hand
    unknown = np.full((count, 4, 4), np.nan), np.full((count, len(hand.joint_names)), np.nan)
    keys = next((keys for keys in (BEFORE, BEFORE_OF_VERSION_0_1) if all(key in file.entries for key in keys)), None)
    if keys is None:
        return unknown
    grasps = load_grasps(file.path)
    # For another base link, poses before refinement would need the hand below the base link of the file.
    if grasps.base_link != problem.groups[0].grasps.base_link:
        return unknown
    stage = _initial_stage(file, keys, grasps)
    q, _ = match_joints(grasps.at(stage), hand)
    return transform_from_pose(stage.pose), q


def _initial_stage(file: NpzFile, keys: tuple[str, str], grasps: GraspSet) -> Stage:
    """Return the entries of two keys, of poses and joint values before refinement, checked."""
    pose, q = (file.numbers(key, allowed="any") for key in keys)
    if pose.shape != grasps.hand_pose.shape or q.shape != grasps.q.shape:
        raise file.error(
            f"{' and '.join(keys)} must have the shapes of hand_pose and q, {grasps.hand_pose.shape} and "
            f"{grasps.q.shape}; they have {pose.shape} and {q.shape}"
        )
    return Stage(unit_poses(pose, keys[0], file.error), q)
