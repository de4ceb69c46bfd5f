"""Functions called on the workers of a cluster: the work on a shard, and the check whether a worker is fit for it."""

from __future__ import annotations

import os
import pickle
import platform
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import distributed

import grasp_refine
from grasp_refine.collision.engine import chosen
from grasp_refine_apps.batch.attempt import attempt
from grasp_refine_apps.batch.shard import Done, Failed, Shard

HEARTBEAT_INTERVAL_S = 1.0
"""Shortest interval between heartbeats of a worker, seconds: all of them pass through the scheduler."""

_WORK_ATTRIBUTE = "grasp_refine_work"


@dataclass(frozen=True)
class WorkerEnvironment:
    """Versions installed for a process, and its access to the folder of the results."""

    versions: tuple[tuple[str, str], ...]
    """Names and versions that must be the same everywhere."""
    reads: bool
    """Whether a file written by another process is visible."""
    writes: bool
    """Whether files can be written beside it."""


def inspect_environment(probe: Path) -> WorkerEnvironment:
    """Return the environment of this process; `probe` is a file that another process has just written."""
    versions = (
        ("grasp-refine", grasp_refine.__version__),
        ("Python", ".".join(platform.python_version_tuple()[:2])),
        ("distributed", str(distributed.__version__)),  # type: ignore[attr-defined]  # it has one
        # Engines agree up to rounding, but not to the last bit.
        ("collision engine", chosen("auto")),
    )
    return WorkerEnvironment(versions, probe.is_file(), os.access(probe.parent, os.W_OK))


def attempt_on_worker(work: bytes, shard: Shard, topic: str) -> Done | Failed:
    """Work on a shard; heartbeats, each after the shard's number, are events of `topic`.

    The worker keeps the unpickled `Work` for the other shards of this topic, with its loaded inputs.
    """
    worker = distributed.get_worker()
    last_sent_s = -HEARTBEAT_INTERVAL_S

    def send(what: str, share: float, refined: int = 0) -> None:
        worker.log_event(topic, [shard.number, what, float(share), int(refined)])

    def heartbeat(what: str, share: float, refined: int = 0) -> None:
        nonlocal last_sent_s
        now = time.monotonic()
        if now - last_sent_s >= HEARTBEAT_INTERVAL_S:
            last_sent_s = now
            send(what, share, refined)

    send("beginning", 0.0)
    kept: tuple[str, Any] = getattr(worker, _WORK_ATTRIBUTE, ("", None))
    if kept[0] != topic:
        kept = (topic, pickle.loads(work))
        setattr(worker, _WORK_ATTRIBUTE, kept)
    return attempt(kept[1], shard, heartbeat)
