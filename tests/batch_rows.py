"""Rows of batches for tests: out of real refinements of an example, and made up in any number."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.assets.embedded import resource_dir
from grasp_refine.closing.motion import closing_motion
from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.grasps.grasp_set import load_grasps, match_joints
from grasp_refine.hands.hand import load_hand
from grasp_refine.objects.object import load_object
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import refine
from grasp_refine.results.outcome import Outcome, compare
from grasp_refine.results.result_files import save_results
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.batch.rows import Rows, column_kinds
from grasp_refine_apps.batch.shard import Shard


def shard(number: int, path: Path, size: int = 4) -> Shard:
    """A shard of which only the result file matters."""
    return Shard(number, "hand/object", f"job, part {number}", size, path, "stamp", None)


def refined(name: str, rows: slice = slice(None)) -> Outcome:
    """Some example grasps of the Allegro-type hand on an embedded object, their geometry refined."""
    hand = load_hand("allegro")
    grasps = load_grasps(resource_dir("robots") / "allegro" / f"example_{name}.npz")
    grasps = grasps.select(np.arange(len(grasps))[rows])
    q, _ = match_joints(grasps, hand)
    scene = Scene(hand, load_object(name), transform_from_pose(grasps.hand_pose), q)
    config = Config()
    config = replace(config, weights=replace(config.weights, wrench=0.0))
    result = refine(scene, config)
    after = replace(scene, T_world_root=result.T_world_root, q=result.q)
    row = np.arange(len(grasps)) + (rows.start or 0)
    return compare(scene, result, closing_motion(after), margin=0.0, name=name, scale=1.0, row=row, index=row)


def save_refined(path: Path, outcome: Outcome, **batch: Any) -> None:
    """Write what a shard of such grasps comes to."""
    hand = load_hand("allegro")
    links = refined_links(hand)
    provenance = {"source": {"path": "example.npz", "sha256": "0"}, "batch": {"job": "examples", **batch}}
    save_results(path, hand, links, outcome, provenance)


def refined_links(hand: Any) -> tuple[str, ...]:
    """The links that per-link arrays are about."""
    from grasp_refine.scene.scene import links_of

    return links_of(hand)


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
