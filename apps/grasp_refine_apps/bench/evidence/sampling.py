"""Sampling of the grasps of a shard into a grasp file, once for all that is done with them."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from grasp_refine.core.json_files import dumps
from grasp_refine.grasps.grasp_set import save_npz
from grasp_refine_apps.batch.shard import Done, Shard
from grasp_refine_apps.batch.work import cache_of, peak_bytes, problem_of
from grasp_refine_apps.processes.task import Heartbeat


@dataclass(frozen=True)
class SamplingWork:
    """Work function that samples the grasps of a shard, and writes them as a grasp file."""

    words: ClassVar[tuple[str, str]] = ("sampling", "sampled")
    """Verb of its progress, and the participle."""
    seed: int
    """Random seed."""

    def __call__(self, shard: Shard, heartbeat: Heartbeat) -> Done:
        """Work on a shard.

        Raises:
            GraspRefineError: hand or object cannot be used, no grasp is found, or the file cannot be written.
        """
        wall, cpu = time.perf_counter(), time.process_time()
        task = shard.task
        problem = problem_of(task, self.seed, cache_of(task.batch), heartbeat)
        grasps = problem.groups[0].grasps
        provenance = {"batch": {"stamp": shard.stamp, "job": task.job}}
        save_npz(shard.path, {**grasps.arrays(), "provenance": np.array(dumps(provenance))})
        return Done(
            grasps=len(grasps),
            usable=len(grasps),
            good=(0, 0),
            held=None,
            wall_s=time.perf_counter() - wall,
            cpu_s=time.process_time() - cpu,
            peak_bytes=peak_bytes(),
        )
