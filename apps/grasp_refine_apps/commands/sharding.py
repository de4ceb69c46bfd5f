"""The options that say how the work of a batch is divided."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated

from tyro.conf import DisallowNone, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.commands.options import check_numbers

LEAST_PATIENCE = 5.0
"""Seconds that a worker has in any case: it takes some to start."""


@dataclass(frozen=True)
class Sharding:
    """How the work is divided."""

    workers: Annotated[DisallowNone[int | None], arg(help_behavior_hint="(default: the cores of this machine)")] = None
    """Processes on this machine; each is replaced when it crashes or hangs, and takes 0.4 to 1 GB."""
    shard_size: int = 64
    """Most grasps of a shard, the unit of all work: a shard becomes one result file, or none."""
    together: bool = False
    """A folder is one set of grasps, as it is for `run`, and not a job for each file in it: for generators that write a
    file for each grasp."""
    shard: Annotated[DisallowNone[str | None], arg(metavar="I/N", help_behavior_hint="(default: everything)")] = None
    """Do only part I (from 1 on) of N of the batch, for the array jobs of a scheduler; all parts share --out."""
    dask: Annotated[DisallowNone[str | None], arg(metavar="ADDRESS", help_behavior_hint="(default: none)")] = None
    """Work on the Dask cluster with this scheduler, such as tcp://host:8786, which sees the same folders; needs the
    extra `cluster`."""
    patience: float = 600.0
    """Seconds without a sign of life after which a worker is killed and its shard tried again; while a mesh is cut into
    convex pieces, there is none."""
    tries: int = 2
    """How often a shard is tried whose worker crashed or hung, before it is recorded as failed."""
    again: bool = False
    """Refine everything anew, also what is there already."""

    def part(self) -> tuple[int, int]:
        """Which part, from 1 on, of how many is done.

        Raises:
            GraspRefineError: an option that cannot be.
        """
        check_numbers(self)
        if self.patience < LEAST_PATIENCE:
            raise GraspRefineError(f"--patience must be at least {LEAST_PATIENCE:g} seconds, got {self.patience:g}")
        if self.dask is not None and self.workers is not None:
            raise GraspRefineError("--workers is for this machine; a cluster (--dask) has workers of its own")
        if self.shard is None:
            return 1, 1
        found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", self.shard)
        if not found or not 1 <= int(found[1]) <= int(found[2]):
            raise GraspRefineError(
                f"--shard {self.shard}: must be I/N, part I of N from 1/N to N/N, as in --shard 3/20"
            )
        return int(found[1]), int(found[2])
