"""What is called on the workers of a cluster: one shard at a time, and the question whether they are fit for it."""

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

BEAT_S = 1.0
"""Signs of life of a worker are at least this far apart: all of them pass through the scheduler."""

_KEPT = "grasp_refine_work"


@dataclass(frozen=True)
class Seen:
    """What a process has installed, and whether it can get at the folder of the results."""

    versions: tuple[tuple[str, str], ...]
    """Name and version of what has to be the same everywhere."""
    reads: bool
    """Whether a file that was written elsewhere is there."""
    writes: bool
    """Whether files can be put beside it."""


def seen(probe: Path) -> Seen:
    """What this process has, and whether it sees the file `probe`, which another has just written."""
    versions = (
        ("grasp-refine", grasp_refine.__version__),
        ("Python", ".".join(platform.python_version_tuple()[:2])),
        ("distributed", str(distributed.__version__)),  # type: ignore[attr-defined]  # it has one
        # Engines give the same to rounding, but not to the last bit.
        ("collision engine", chosen("auto")),
    )
    return Seen(versions, probe.is_file(), os.access(probe.parent, os.W_OK))


def attempt_there(work: bytes, shard: Shard, topic: str) -> Done | Failed:
    """What comes of a shard; signs of life, each after the shard's number, are events of `topic`.

    The worker keeps the unpickled `Work` for the other shards of this topic, with all that it has loaded.
    """
    worker = distributed.get_worker()
    heard = -BEAT_S

    def tell(what: str, share: float, refined: int = 0) -> None:
        worker.log_event(topic, [shard.number, what, float(share), int(refined)])

    def heartbeat(what: str, share: float, refined: int = 0) -> None:
        nonlocal heard
        now = time.monotonic()
        if now - heard >= BEAT_S:
            heard = now
            tell(what, share, refined)

    tell("beginning", 0.0)
    kept: tuple[str, Any] = getattr(worker, _KEPT, ("", None))
    if kept[0] != topic:
        kept = (topic, pickle.loads(work))
        setattr(worker, _KEPT, kept)
    return attempt(kept[1], shard, heartbeat)
