"""Processes that tests start: who runs, and who is gone, as /proc tells it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from subprocess import Popen
from typing import Any

PATIENCE_S = 600.0
"""Only so that nothing hangs for ever: a busy machine may take its time."""


def soon(holds: Callable[[], Any], seconds: float = PATIENCE_S) -> Any:
    """What `holds` returns as soon as that counts as true, or its last answer."""
    until = time.monotonic() + seconds
    while not (found := holds()) and time.monotonic() < until:
        time.sleep(0.02)
    return found


def alive(number: int) -> bool:
    """Whether a process runs; one that has ended and waits for its parent to notice does not."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def children(number: int) -> list[str]:
    """The processes that a process started, in its main thread."""
    return Path(f"/proc/{number}/task/{number}/children").read_text().split()


def running_in_session(process: Popen[str]) -> dict[int, str]:
    """The command lines of the processes in the session that a process leads, or led."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, _, session, *_ = (folder / "stat").read_text().rpartition(")")[2].split()
            if int(session) == process.pid and state != "Z":
                found[int(folder.name)] = (folder / "cmdline").read_text().replace("\0", " ")
        except OSError:
            continue
    return found


def nothing_left(process: Popen[str]) -> bool:
    """Whether everything in the session of a process ends: what looks after resources ends last."""
    return soon(lambda: not running_in_session(process))
