"""State of a batch in one run of the command."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field
from typing import Any

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.batch.bundle import Bundle
from grasp_refine_apps.batch.failed import suspected
from grasp_refine_apps.batch.plan import Refused
from grasp_refine_apps.batch.progress import Progress
from grasp_refine_apps.batch.record import clean, forget_failure, note_failure, noted_failure
from grasp_refine_apps.batch.shard import Done, Shard
from grasp_refine_apps.batch.statistics import Statistics
from grasp_refine_apps.batch.work import peak_bytes
from grasp_refine_apps.processes.dispatch import Pool, dispatch
from grasp_refine_apps.processes.task import Failed

MAX_UNWRITTEN = 3
"""Number of shards in a row that find the disk full, after which no other is tried."""

BYTES_PER_GRASP = 4096
"""Size of a refined grasp in a result file, bytes, where no result file shows it."""


@dataclass(eq=False)
class Session:
    """State of a batch, or of a part of it: results and costs of this run of the command, and complete shards."""

    shards: tuple[Shard, ...]
    """All shards of the batch or part."""
    refused: tuple[Refused, ...]
    """Jobs that cannot be done."""
    complete: set[int]
    """Numbers of the shards with result files."""
    skipped: int = field(init=False)
    """Number of grasps that were complete before."""
    done: int = 0
    """Number of shards completed."""
    failed: dict[int, Failed] = field(default_factory=dict)
    """Number of each failed shard -> failure."""
    grasps: int = 0
    """Number of grasps in completed shards."""
    wall_s: float = 0.0
    """Wall time of the work on shards, seconds."""
    cpu_s: float = 0.0
    """CPU time of the work, without starting the workers, seconds."""
    peak_bytes: int = 0
    """Largest resident memory of a worker, bytes."""
    notes: set[str] = field(default_factory=set)
    """Notes that were printed."""
    profile: dict[str, tuple[float, float, int]] = field(default_factory=dict)
    """Stage -> CPU seconds, wall seconds and calls of all shards."""
    statistics: Statistics = field(default_factory=Statistics.empty)
    """Statistics of all grasps in the result files, once they are read."""
    disk_full: bool = False
    """Whether the work stopped for want of room."""

    def __post_init__(self) -> None:
        """Count complete shards."""
        self.skipped = sum(shard.size for shard in self.complete_shards)

    @property
    def complete_shards(self) -> list[Shard]:
        """Shards with result files, in order."""
        return [shard for shard in self.shards if shard.number in self.complete]

    @property
    def left(self) -> list[Shard]:
        """Shards without result files, in order."""
        return [shard for shard in self.shards if shard.number not in self.complete]

    @property
    def open_grasps(self) -> int:
        """Number of grasps in shards without result files."""
        return sum(shard.size for shard in self.left)

    @property
    def room_bytes(self) -> int:
        """Estimated size of the result files that are missing, bytes, by that of the others."""
        done = self.complete_shards
        sizes = [shard.path.stat().st_size for shard in done]
        each = sum(sizes) / sum(shard.size for shard in done) if done else BYTES_PER_GRASP
        return int(each * self.open_grasps)

    def run(
        self, bundles: Sequence[Bundle], pool: Pool, progress: Progress, *, tries: int, patience_s: float | None
    ) -> None:
        """Work on bundles of shards, and record the result of each shard; stop when nothing more can be written.

        Shards of a bundle whose worker is lost are tried again one by one.

        Args:
            bundles: The bundles.
            pool: The workers.
            progress: Display of heartbeats and results.
            tries: Maximum attempts at a shard whose worker crashes or hangs.
            patience_s: Time without a heartbeat, seconds, after which a worker counts as hanging; None: no limit.

        Raises:
            KeyboardInterrupt: raised again; shards complete by then are kept.
        """
        by_number = {bundle.number: bundle for bundle in bundles}
        unwritten, apart = 0, list[Bundle]()

        def heartbeat(number: int, what: str, share: float, refined: int) -> None:
            for shard in by_number[number].shards:
                progress.heartbeat(shard.number, what, share, refined * shard.size // by_number[number].size)

        try:
            with closing(dispatch(bundles, pool, tries=tries, patience_s=patience_s, heartbeat=heartbeat)) as results:
                for bundle, found in results:
                    if isinstance(found, Failed) and len(bundle.shards) > 1:
                        apart += [Bundle((shard,)) for shard in bundle.shards]
                        continue
                    each = (found,) if isinstance(found, Failed) else found
                    for shard, result in zip(bundle.shards, each, strict=True):
                        self.take(shard, result, progress)
                        full = isinstance(result, Failed) and result.reason == "disk full"
                        unwritten = unwritten + 1 if full else 0
                        if unwritten >= MAX_UNWRITTEN:
                            self.disk_full = True
                            return
        finally:
            # Killed workers leave partial files.
            clean(shard.path for bundle in bundles for shard in bundle.shards)
        if apart:
            self.run(apart, pool, progress, tries=tries, patience_s=patience_s)

    def take(self, shard: Shard, result: Done | Failed, progress: Progress) -> None:
        """Record and show the result of a shard."""
        if isinstance(result, Failed):
            self.failed[shard.number] = result
            progress.failed(shard, result)
            try:
                note_failure(shard, result)
            except GraspRefineError as error:
                progress.say(str(error))
            return
        self.complete.add(shard.number)
        forget_failure(shard)
        self.done += 1
        self.grasps += result.grasps
        self.cpu_s += result.cpu_s
        self.peak_bytes = max(self.peak_bytes, result.peak_bytes)
        for stage, spent in result.profile.items():
            cpu_s, wall_s, calls = self.profile.get(stage, (0.0, 0.0, 0))
            self.profile[stage] = cpu_s + spent[0], wall_s + spent[1], calls + spent[2]
        for note in result.notes:
            if note not in self.notes:
                self.notes.add(note)
                progress.say(f"note: {note}")
        for note in result.convention_notes:
            # Notes of the shards of a job differ in the number of affected grasps.
            sign = f"{shard.task.job}: {note.partition(':')[0]}"
            if sign not in self.notes:
                self.notes.add(sign)
                progress.say(f"note: {shard.task.job}: {note}")
        progress.done(shard, result)

    def lose(self, shard: Shard, error: GraspRefineError, progress: Progress) -> None:
        """Record and show that the result of a complete shard is damaged or of another batch."""
        self.complete.discard(shard.number)
        self.failed[shard.number] = Failed.of(error)
        progress.say(str(error))

    def failures(self) -> list[dict[str, Any]]:
        """Entries of refused jobs and failed shards, including failures of an earlier run, with reasons."""
        nothing = {"shard": None, "path": None, "reason": "refused", "tries": 0}
        found: list[dict[str, Any]] = [
            {**nothing, "name": one.job, "message": one.message, "traceback": one.traceback} for one in self.refused
        ]
        for shard in self.shards:
            # A note may be missing: it could not be written.
            failed = self.failed.get(shard.number) or noted_failure(shard)
            if shard.number not in self.complete and failed is not None:
                found.append({"shard": shard.number, "name": shard.name, "path": shard.path, **asdict(failed)})
        return found

    def totals(self, failed: Sequence[Mapping[str, Any]], wall_s: float, cpu_s: float) -> dict[str, Any]:
        """Counts of the whole batch and of its failures, and costs of this run."""
        return {
            **self.statistics.totals(),
            "shards": len(self.shards),
            "done": self.done,
            "complete": len(self.complete),
            "skipped": self.skipped,
            "failed": len(failed),
            "suspected": suspected(failed),
            "wall_s": wall_s,
            "cpu_s": cpu_s,
            "grasps_per_s": self.grasps / self.wall_s if self.wall_s else None,
            "cpu_s_per_grasp": self.cpu_s / self.grasps if self.grasps else None,
            "peak_bytes": max(self.peak_bytes, peak_bytes()),
        }

    def jobs(self) -> list[dict[str, Any]]:
        """Numbers of grasps, shards and complete shards of each job."""
        counts: dict[str, Counter[str]] = {}
        for shard in self.shards:
            count = counts.setdefault(shard.task.job, Counter())
            count.update({"grasps": shard.size, "shards": 1, "complete": int(shard.number in self.complete)})
        return [{"job": job, **count} for job, count in counts.items()]
