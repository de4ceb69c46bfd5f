"""Functions called on the workers of a Dask cluster: the work on a task, and the check whether a worker is fit."""

from __future__ import annotations

import os
import pickle
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import distributed

import grasp_refine
from grasp_refine.collision.engine import chosen
from grasp_refine_apps.processes.task import Sign, Task, attempt, message_of

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


def fault_of(there: object, here: WorkerEnvironment, threads: int, folder: Path) -> str:
    """Fault of a worker; empty if there is none.

    Args:
        there: Environment of the worker, or the error of its check.
        here: Environment of this process.
        threads: Number of threads of the worker.
        folder: Folder of the results.
    """
    if not isinstance(there, WorkerEnvironment):
        reason = message_of(there) if isinstance(there, BaseException) else "no answer"
        return f"cannot run grasp-refine ({reason}): install there the same packages as here"
    if there.versions != here.versions:
        ours, theirs = (", ".join(" ".join(pair) for pair in each.versions) for each in (here, there))
        return f"has {theirs}, but here are {ours}: install the same in both places"
    if not (there.reads and there.writes):
        verb = "write into" if there.reads else "see"
        return f"cannot {verb} {folder}: results need a folder that all machines share, under the same name"
    if threads != 1:
        return f"has {threads} threads, but works on one shard at a time: start workers with --nthreads 1"
    return ""


def attempt_on_worker(work: bytes, task: Task, topic: str, key: str) -> Any:
    """Work on a task; heartbeats, each after the `key` of the attempt, are events of `topic`.

    The worker keeps the unpickled `Work` for the other tasks of this topic, with its loaded inputs.
    """
    worker = distributed.get_worker()

    def send(sign: Sign) -> None:
        worker.log_event(topic, [key, *sign])

    send(Sign("beginning", 0.0, 0))
    kept: tuple[str, Any] = getattr(worker, _WORK_ATTRIBUTE, ("", None))
    if kept[0] != topic:
        kept = (topic, pickle.loads(work))
        setattr(worker, _WORK_ATTRIBUTE, kept)
    return attempt(kept[1], task, send, HEARTBEAT_INTERVAL_S)
