"""State of a batch: in one run of the command, and after all runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.batch.progress import Progress
from grasp_refine_apps.batch.record import forget_failure, note_failure, noted_failure
from grasp_refine_apps.batch.shard import Done, Shard
from grasp_refine_apps.batch.statistics import Statistics
from grasp_refine_apps.commands.shard_plan import Refused
from grasp_refine_apps.commands.shard_work import peak_bytes
from grasp_refine_apps.processes.task import Failed


@dataclass(eq=False)
class Session:
    """Results and costs of one run of the command."""

    complete: set[int]
    """Numbers of the shards with result files."""
    num_shards: int
    """Number of shards of this run or part."""
    skipped: int = 0
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


@dataclass(frozen=True, eq=False)
class Summary:
    """State of a batch, or of a part of it, after a run of the command, from this and earlier runs."""

    shards: tuple[Shard, ...]
    """All shards of the batch or part."""
    complete: tuple[Shard, ...]
    """Shards with result files, in order."""
    failed: list[dict[str, Any]]
    """Entries of failed shards and refused jobs, with reasons."""
    statistics: Statistics
    """Statistics of all grasps in the result files."""

    @staticmethod
    def of(shards: tuple[Shard, ...], refused: Sequence[Refused], session: Session) -> Summary:
        """Return the summary, still without statistics."""
        failed = [_entry(None, one.job, None, "refused", one.message, 0, "") for one in refused]
        for shard in shards:
            if shard.number not in session.complete:
                # A note may be missing: it could not be written.
                failure = session.failed.get(shard.number) or noted_failure(shard)
                if failure is not None:
                    details = (failure.reason, failure.message, failure.tries, failure.traceback)
                    failed.append(_entry(shard.number, shard.name, shard.path, *details))
        complete = tuple(shard for shard in shards if shard.number in session.complete)
        return Summary(shards, complete, failed, Statistics.empty())

    def totals(self, session: Session, wall_s: float, cpu_s: float) -> dict[str, Any]:
        """Counts of the whole batch, and costs of this run."""
        return {
            **self.statistics.totals(),
            "shards": len(self.shards),
            "done": session.done,
            "complete": len(self.complete),
            "skipped": session.skipped,
            "failed": len(self.failed),
            "wall_s": wall_s,
            "cpu_s": cpu_s,
            "grasps_per_s": session.grasps / session.wall_s if session.wall_s else None,
            "cpu_s_per_grasp": session.cpu_s / session.grasps if session.grasps else None,
            "peak_bytes": max(session.peak_bytes, peak_bytes()),
        }

    def jobs(self) -> list[dict[str, Any]]:
        """Numbers of grasps, shards and complete shards of each job."""
        there = {shard.number for shard in self.complete}
        counts: dict[str, Counter[str]] = {}
        for shard in self.shards:
            count = counts.setdefault(shard.task.job, Counter())
            found: Mapping[str, int] = {"grasps": shard.size, "shards": 1, "complete": int(shard.number in there)}
            count.update(found)
        return [{"job": job, **count} for job, count in counts.items()]


def _entry(
    number: int | None, name: str, path: Path | None, reason: str, message: str, tries: int, traceback: str
) -> dict[str, Any]:
    """Entry of a failed shard or a refused job."""
    return {
        "shard": number,
        "name": name,
        "path": path,
        "reason": reason,
        "message": message,
        "tries": tries,
        "traceback": traceback,
    }
