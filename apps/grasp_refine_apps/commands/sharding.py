"""Options for the division of the work of a batch."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated, ClassVar

from tyro.conf import DisallowNone, arg

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.commands.option_rules import OptionGroup
from grasp_refine_apps.commands.options import check_numbers

MIN_PATIENCE_S = 5.0
"""Minimum of --patience, seconds: a worker takes some to start."""

SHARD_SIZE, SIMULATED_SHARD_SIZE = 64, 16
"""Grasps of a shard where they are refined only, and where they are simulated, which takes ten times as long: a minute
or less of work, so that all workers have some."""


@dataclass(frozen=True)
class Sharding:
    """Division of the work among processes, machines and calls."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (OptionGroup("work"),)

    workers: Annotated[DisallowNone[int | None], arg(help_behavior_hint="(default: the cores of this machine)")] = None
    """Number of processes on this machine; each takes 0.4 to 1 GB, and is replaced when it crashes or hangs."""
    shard_size: Annotated[
        DisallowNone[int | None],
        arg(help_behavior_hint=f"(default: {SHARD_SIZE}, {SIMULATED_SHARD_SIZE} with --validate)"),
    ] = None
    """Maximum number of grasps of a shard, the unit of work: a shard becomes one result file, or fails."""
    together: bool = False
    """Treat a folder as one set of grasps, as `run` does, instead of one job per file: for generators that write a file
    for each grasp."""
    shard: Annotated[DisallowNone[str | None], arg(metavar="I/N", help_behavior_hint="(default: everything)")] = None
    """Do only part I (from 1 on) of N of the batch, for array jobs of a scheduler; all parts share --out."""
    dask: Annotated[DisallowNone[str | None], arg(metavar="ADDRESS", help_behavior_hint="(default: none)")] = None
    """Address of the scheduler of a Dask cluster, such as tcp://host:8786; all machines must share the folders. Needs
    the extra `cluster`."""
    patience: float = 600.0
    """Seconds without a heartbeat after which a worker is killed and its shard tried again; there is none while a mesh
    is decomposed."""
    tries: int = 2
    """Maximum attempts at a shard whose worker crashes or hangs, before it is recorded as failed."""
    again: bool = False
    """Refine everything again, including complete results."""

    def size(self, *, simulated: bool) -> int:
        """Return the maximum number of grasps of a shard, for grasps that are simulated or not."""
        default = SIMULATED_SHARD_SIZE if simulated else SHARD_SIZE
        return default if self.shard_size is None else self.shard_size

    def part(self) -> tuple[int, int]:
        """Return the part to do, from 1 on, and the number of parts.

        Raises:
            GraspRefineError: an invalid option.
        """
        check_numbers(self)
        if self.patience < MIN_PATIENCE_S:
            raise GraspRefineError(f"--patience must be at least {MIN_PATIENCE_S:g} seconds, got {self.patience:g}")
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
