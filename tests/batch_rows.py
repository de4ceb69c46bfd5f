"""Rows and summaries of batches that are made up, in any number."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine_apps.batch.rows import Rows, column_kinds
from grasp_refine_apps.batch.shard import Shard


def shard(number: int, path: Path, size: int = 4) -> Shard:
    """A shard of which only the result file matters."""
    return Shard(number, "hand/object", f"job, part {number}", size, path, "stamp", None)


def made_up_rows(count: int, number: int = 0, seed: int = 0, **columns: Any) -> Rows:
    """Rows with plausible numbers; those of `columns` are as given."""
    random = np.random.default_rng([seed, number])
    kinds = column_kinds()
    plain = {name: random.uniform(0.1, 0.9, count) for name, kind in kinds.items() if kind == "number"}
    found = {
        **plain,
        **{
            name: random.integers(0, 100, count).astype(float)
            for name, kind in column_kinds().items()
            if kind == "whole"
        },
        **{name: (random.random(count) < 0.5).astype(float) for name, kind in kinds.items() if kind == "flag"},
        **{name: np.full(count, "") for name, kind in kinds.items() if kind == "text"},
        "job": np.full(count, "job"),
        "shard": np.full(count, float(number)),
        "file": np.full(count, f"job/{number:05d}.npz"),
        "row_in_file": np.arange(count, dtype=float),
        "hand": np.full(count, "allegro"),
        "object": np.full(count, "mug"),
        "source": np.full(count, "grasps.npz"),
        "status": np.full(count, "converged"),
    }
    changed = {name: np.broadcast_to(np.asarray(value), (count,)) for name, value in columns.items()}
    found |= {name: value if value.dtype.kind == "U" else value.astype(float) for name, value in changed.items()}
    return Rows({name: found[name] for name in column_kinds()})


def document(**changes: Any) -> Mapping[str, Any]:
    """The JSON summary of a batch in which nothing failed."""
    return {
        "schema": 1,
        "command": "batch",
        "invocation": "refine-grasp batch sets",
        "versions": {"grasp-refine": "0.1.0"},
        "config": {"refine": {"type": "Config", "starts": 6}},
        "seed": 0,
        "totals": {"shards": 2, "complete": 2, "done": 2, "wall_s": 10.0, "grasps_per_s": 12.0, "peak_bytes": 2**29},
        "failed": [],
        "jobs": [{"job": "sets", "grasps": 8, "shards": 2, "complete": 2}],
        **changes,
    }


def failure(number: int | None, message: str = "torn.obj: has holes", reason: str = "error") -> dict[str, Any]:
    """How the summary tells of a shard that failed; without a number, of a job."""
    path = None if number is None else Path(f"out/{number}.npz")
    tries = {"error": 1, "refused": 0}.get(reason, 2)
    traceback = "" if number is None else f"Traceback of <{number}>"
    return {
        "shard": number, "name": f"part {number}", "path": path, "reason": reason, "message": message, "tries": tries,
        "traceback": traceback,
    }  # fmt: skip
