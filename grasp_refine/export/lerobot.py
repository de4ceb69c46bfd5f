"""Target `lerobot`: a LeRobot data set, version 3, with one episode a grasp.

The layout is that of `lerobot.datasets` 0.4, whose class reads the folder: https://github.com/huggingface/lerobot.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import save_json
from grasp_refine.core.plurals import first_of
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.export.exported import ExportedGrasps
from grasp_refine.export.target import Readme
from grasp_refine.export.timed import timed
from grasp_refine.grasps.grasp_set import POSE_COLUMNS
from grasp_refine.motion.plan import plan_motions
from grasp_refine.motion.trajectory import PERIOD_S, Trajectory
from grasp_refine.motion.trajectory_context import all_values
from grasp_refine.results.validation_document import save_parquet

FPS = round(1.0 / PERIOD_S)
"""Frames a second: every set point of a trajectory is one."""

STATE, ACTION = "observation.state", "action"

DATA, EPISODES, TASKS = (
    "data/chunk-000/file-000.parquet",
    "meta/episodes/chunk-000/file-000.parquet",
    "meta/tasks.parquet",
)
PATTERN = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
"""Quantiles of the statistics."""

INDICES = ("frame_index", "episode_index", "index", "task_index")
"""Columns of integers that every data set has, beside `timestamp`."""


@dataclass(frozen=True)
class LeRobot:
    """Episodes of closing hands, for imitation learning."""

    name: str = "lerobot"
    what: str = "a LeRobot v3 data set: an episode a grasp, with state and action of base link and joints"
    extra: str = "parquet"

    def write(self, grasps: ExportedGrasps, folder: Path) -> Readme:
        """Write data, episodes, tasks, statistics and `info.json`.

        Raises:
            GraspRefineError: no grasp has a pose and joint values that are finite, or pyarrow is not installed.
        """
        _check_pyarrow()
        plans = plan_motions(grasps.scene, grasps.motion)
        rows = [row for row, plan in enumerate(plans) if plan.direction is not None]
        if not rows:
            raise GraspRefineError(f"{grasps.name}: no grasp can be written as an episode: {plans[0].why}")
        episodes = [_frames(grasps, timed(grasps, plans[row], row)) for row in rows]
        lengths = np.array([len(episode[STATE]) for episode in episodes])
        ends = np.cumsum(lengths)
        for number, episode in enumerate(episodes):
            begin = ends[number] - lengths[number]
            frame = np.arange(lengths[number])
            zero = np.zeros(lengths[number], dtype=np.int64)
            episode |= {"timestamp": (frame * PERIOD_S).astype(np.float32), "frame_index": frame}
            episode |= {"episode_index": zero + number, "index": begin + frame, "task_index": zero}
        task = f"grasp {grasps.name}"
        whole = {name: np.concatenate([episode[name] for episode in episodes]) for name in episodes[0]}
        _save_parquet(folder / DATA, {name: values.tolist() for name, values in whole.items()}, floats=True)
        _save_parquet(folder / EPISODES, _episode_columns(episodes, task, lengths))
        _save_tasks(folder / TASKS, task)
        save_json(folder / "meta/stats.json", _statistics(whole))
        save_json(folder / "meta/info.json", _info(grasps, len(episodes), int(ends[-1])))
        beyond = [f"Grasp {row} is left out: {plan.why}." for row, plan in enumerate(plans) if plan.direction is None]
        return Readme(
            {
                "data, meta": f"{len(episodes)} episodes, {FPS} frames a second, in the layout v3.0",
                DATA: f"{STATE} and {ACTION}: pose of `{grasps.hand.base_link}`, then all joints",
            },
            use='LeRobotDataset("grasps", root=".")',
            notes=(
                "Poses are in the frame of the object, x y z in metres, then qw qx qy qz; joints in rad or m.",
                f"{ACTION} is the next set point, {STATE} the present one: nothing was simulated or recorded.",
                *first_of(beyond, 5),
            ),
        )


def _check_pyarrow() -> None:
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise GraspRefineError('a LeRobot data set needs pyarrow: pip install "grasp-refine[parquet]"') from None


def _frames(grasps: ExportedGrasps, moved: Trajectory) -> dict[str, np.ndarray]:
    """Return state and action (T, 7 + m) of each frame: base link and all joints, quaternions without sign flips."""
    pose = pose_from_transform(moved.T_world_root)
    flipped = np.cumprod(np.where((pose[1:, 3:] * pose[:-1, 3:]).sum(axis=1) < 0.0, -1.0, 1.0))
    pose[1:, 3:] *= flipped[:, None]
    values = np.concatenate([pose, all_values(grasps.hand, moved.q)], axis=1).astype(np.float32)
    return {STATE: values, ACTION: np.concatenate([values[1:], values[-1:]])}


def _info(grasps: ExportedGrasps, episodes: int, frames: int) -> dict[str, Any]:
    """Return the description of the data set."""
    names = [*POSE_COLUMNS, *grasps.joint_names]
    vector = {"dtype": "float32", "shape": [len(names)], "names": names}
    scalar = {"shape": [1], "names": None}
    features = {STATE: vector, ACTION: vector, "timestamp": {"dtype": "float32", **scalar}}
    return {
        "codebase_version": "v3.0",
        "robot_type": grasps.hand.name,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": FPS,
        "splits": {"train": f"0:{episodes}"},
        "data_path": f"data/{PATTERN}",
        "video_path": None,
        "features": features | {name: {"dtype": "int64", **scalar} for name in INDICES},
    }


def _statistics(frames: dict[str, np.ndarray]) -> dict[str, dict[str, list[float]]]:
    """Return the statistics of each column over frames."""
    found = {}
    for name, values in frames.items():
        flat = values.reshape(len(values), -1).astype(np.float64)
        kinds = {"min": flat.min(axis=0), "max": flat.max(axis=0), "mean": flat.mean(axis=0), "std": flat.std(axis=0)}
        kinds |= {f"q{round(100 * share):02d}": np.quantile(flat, share, axis=0) for share in QUANTILES}
        found[name] = {kind: each.tolist() for kind, each in kinds.items()} | {"count": [len(values)]}
    return found


def _episode_columns(episodes: list[dict[str, np.ndarray]], task: str, lengths: np.ndarray) -> dict[str, list[Any]]:
    """Return the columns of the table of episodes."""
    ends, count = np.cumsum(lengths), len(episodes)
    columns: dict[str, list[Any]] = {
        "episode_index": list(range(count)),
        "tasks": [[task]] * count,
        "length": lengths.tolist(),
        "dataset_from_index": (ends - lengths).tolist(),
        "dataset_to_index": ends.tolist(),
    }
    for part in ("data", "meta/episodes"):
        columns |= {f"{part}/{kind}_index": [0] * count for kind in ("chunk", "file")}
    statistics = [dict(_flat(_statistics(episode))) for episode in episodes]
    return columns | {name: [one[name] for one in statistics] for name in statistics[0]}


def _flat(statistics: dict[str, dict[str, list[float]]]) -> Iterator[tuple[str, list[float]]]:
    for name, kinds in statistics.items():
        for kind, values in kinds.items():
            yield f"stats/{name}/{kind}", values


def _save_tasks(path: Path, task: str) -> None:
    """Write the table of tasks, whose text is the index of a data frame of pandas."""
    index = "__index_level_0__"
    described = {
        "index_columns": [index],
        "column_indexes": [],
        "columns": [
            _pandas_column("task_index", "int64"),
            {**_pandas_column(index, "unicode", "object"), "name": None},
        ],
    }
    _save_parquet(path, {"task_index": [0], index: [task]}, metadata={"pandas": json.dumps(described)})


def _pandas_column(name: str, kind: str, numpy_type: str | None = None) -> dict[str, Any]:
    return {
        "name": name,
        "field_name": name,
        "pandas_type": kind,
        "numpy_type": numpy_type or kind,
        "metadata": None,
    }


def _save_parquet(
    path: Path, columns: dict[str, list[Any]], *, floats: bool = False, metadata: dict[str, str] | None = None
) -> None:
    """Write columns as Parquet; `floats`: numbers with a fraction in single precision."""
    import pyarrow

    table = pyarrow.table(columns)
    if floats:
        single = {
            pyarrow.float64(): pyarrow.float32(),
            pyarrow.list_(pyarrow.float64()): pyarrow.list_(pyarrow.float32()),
        }
        table = table.cast(
            pyarrow.schema([pyarrow.field(one.name, single.get(one.type, one.type)) for one in table.schema])
        )
    if metadata is not None:
        table = table.replace_schema_metadata(metadata)
    save_parquet(path, table)
