"""Task, the unit of work of a process, its heartbeats, and its end: a result, or the reason of the failure."""

from __future__ import annotations

import errno
import pickle
import time
from collections.abc import Callable
from dataclasses import dataclass
from traceback import format_exception
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

from grasp_refine.core.errors import ConventionError, GraspRefineError

_MAX_MESSAGE_CHARACTERS, _MAX_TRACEBACK_CHARACTERS = 500, 20_000


@runtime_checkable
class Task(Protocol):
    """Input of one call of the work function; can be pickled."""

    @property
    def number(self) -> int:
        """Index among the tasks of one run."""
        ...

    @property
    def group(self) -> str:
        """Key of what tasks share and load once: a worker that has done one of a group gets the others."""
        ...


class Sign(NamedTuple):
    """Heartbeat of a running task."""

    what: str
    """Current step."""
    share: float
    """Share (0 to 1) of the task that is done."""
    finished: int
    """Number of finished items of the task, such as refined grasps."""


@runtime_checkable
class Heartbeat(Protocol):
    """Receiver of heartbeats."""

    def __call__(self, what: str, share: float, finished: int = 0) -> None:
        """Report the entries of a `Sign`."""
        ...


Work = Callable[[Any, Heartbeat], Any]
"""Function of a task and the receiver of its heartbeats; it and its results can be pickled."""

Reason = Literal["error", "suspected", "disk full", "crashed", "hung"]
"""Reason of a failure: the work raised, suspects another convention, or found a disk full; the worker ended, or gave no
heartbeat."""

LOST: tuple[Reason, ...] = ("crashed", "hung")
"""Reasons of lost workers."""


@dataclass(frozen=True)
class Failed:
    """Outcome of a failed task."""

    reason: Reason
    """Kind of failure."""
    message: str
    """Cause, in one line for people."""
    traceback: str
    """Traceback of Python, or the end of the worker's log."""
    tries: int = 1
    """Number of attempts."""

    @staticmethod
    def of(error: BaseException) -> Failed:
        """Return the failure of work that raised an exception."""
        reason: Reason = "disk full" if is_disk_full(error) else "error"
        reason = "suspected" if isinstance(error, ConventionError) else reason
        return Failed(reason, message_of(error), traceback_of(error))


def attempt(work: Work, task: Task, send: Callable[[Sign], None], interval_s: float) -> Any:
    """Work on a task in a worker; return its result, or a Failed for any exception, which can always be pickled.

    Args:
        work: Work function.
        task: Task.
        send: Called with heartbeats.
        interval_s: Shortest interval between two heartbeats, seconds.
    """
    last_sent_s = -interval_s

    def heartbeat(what: str, share: float, finished: int = 0) -> None:
        nonlocal last_sent_s
        now_s = time.monotonic()
        if now_s - last_sent_s >= interval_s:
            last_sent_s = now_s
            send(Sign(what, float(share), int(finished)))

    try:
        result = work(task, heartbeat)
        pickle.dumps(result)
        return result
    except Exception as error:
        return Failed.of(error)


def is_disk_full(error: BaseException | None) -> bool:
    """Return True if an exception, or one that caused it, says that a disk is full or a quota is used up."""
    while error is not None and not (isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)):
        error = error.__cause__
    return error is not None


def message_of(error: BaseException) -> str:
    """One-line message of an exception, with its type unless it is a GraspRefineError."""
    try:
        text = str(error)
    except Exception:
        text = "its message cannot be printed"
    name = "" if isinstance(error, GraspRefineError) else type(error).__name__
    line = ": ".join(filter(None, [name, " ".join(text.split())]))
    return line if len(line) <= _MAX_MESSAGE_CHARACTERS else f"{line[:_MAX_MESSAGE_CHARACTERS]} ..."


def traceback_of(error: BaseException) -> str:
    """Traceback of an exception; of a long one the end."""
    text = "".join(format_exception(error)).strip()
    return text if len(text) <= _MAX_TRACEBACK_CHARACTERS else f"... {text[-_MAX_TRACEBACK_CHARACTERS:]}"
