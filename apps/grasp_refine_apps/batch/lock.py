"""Lock of a results folder: the batch that works there, and on which part of it."""

from __future__ import annotations

import hashlib
import json
import os
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import save_json
from grasp_refine.core.machine import host
from grasp_refine_apps.batch.record import is_alive
from grasp_refine_apps.batch.shard import Shard

PREFIX = ".working."
"""Beginning of the names of lock files; host and process follow."""

TOUCH_INTERVAL_S, STALE_S = 20.0, 120.0
"""Interval at which a lock is touched, and age from which it counts as left behind, seconds."""


@dataclass(frozen=True)
class Worker:
    """A batch that works in a folder."""

    host: str
    """Name of the machine."""
    pid: int
    """Process on it."""
    since: float
    """Start, seconds since 1970."""
    plan: str
    """Hash of the inputs and settings of all shards."""
    part: tuple[int, int]
    """Part of the batch and number of parts."""

    @property
    def name(self) -> str:
        """Name of its lock file."""
        return f"{PREFIX}{self.host}.{self.pid}.json"

    def collides(self, other: Worker) -> bool:
        """Return True if both would write the same files, or files of different batches."""
        apart = self.part[1] == other.part[1] and self.part != other.part
        return self.plan != other.plan or not apart


@contextmanager
def locked(out: Path, shards: Sequence[Shard], part: tuple[int, int]) -> Iterator[None]:
    """Lock a folder for a part of a batch while the block runs.

    Other parts of the same batch may be refined in the folder at the same time. A lock is left behind by a process
    that was killed if it is older than `STALE_S`, or if there is no such process on this host.

    Args:
        out: Folder of the results; it is made if it is missing.
        shards: All shards of the batch.
        part: Part of the batch and number of parts.

    Raises:
        GraspRefineError: another batch works there, with its host and process; or the lock cannot be written.
    """
    plan = hashlib.sha256("\n".join(f"{shard.path} {shard.stamp}" for shard in shards).encode()).hexdigest()
    us = Worker(host(), os.getpid(), time.time(), plan, part)
    path, done = out / us.name, threading.Event()
    save_json(path, asdict(us))
    try:
        for other in _others(out, path):
            # Of two that start at the same moment the first one stays.
            if us.collides(other) and (other.since, other.name) < (us.since, us.name):
                raise GraspRefineError(_refusal(out, us, other))
        toucher = threading.Thread(target=_touch, args=(path, done), daemon=True)
        toucher.start()
        try:
            yield
        finally:
            done.set()
            toucher.join()
    finally:
        with suppress(OSError):
            path.unlink(missing_ok=True)


def _refusal(out: Path, us: Worker, other: Worker) -> str:
    since = time.strftime("%Y-%m-%d %H:%M", time.localtime(other.since))
    what = "this batch" if us.plan == other.plan else "another batch"
    there = f"process {other.pid} on {other.host} since {since}"
    return (
        f"{out}: {what} is being refined there already, by {there}; wait for its end or give another --out. "
        f"If it has ended, delete {out / other.name}"
    )


def _others(out: Path, own: Path) -> Iterator[Worker]:
    """Yield the other batches that work in a folder; locks left behind are removed."""
    now = own.stat().st_mtime
    for path in sorted(out.glob(f"{PREFIX}*.json")):
        if path == own:
            continue
        try:
            raw = json.loads(path.read_text(encoding="utf-8"))
            other = Worker(str(raw["host"]), int(raw["pid"]), float(raw["since"]), str(raw["plan"]), tuple(raw["part"]))
            # Both times are of the clock of the folder's file system.
            age_s = now - path.stat().st_mtime
        except (OSError, ValueError, LookupError, TypeError):
            continue
        ended = other.host == host() and not is_alive(other.pid)
        if age_s < STALE_S and not ended:
            yield other
        else:
            with suppress(OSError):
                path.unlink(missing_ok=True)


def _touch(path: Path, done: threading.Event) -> None:
    """Touch a lock file again and again until the work is done."""
    while not done.wait(TOUCH_INTERVAL_S):
        with suppress(OSError):
            os.utime(path)
