"""How commands end: with an exit code, and with what they cost."""

from __future__ import annotations

import os

NOTHING_USABLE = 1
"""Exit code when nothing usable came out."""


def cpu_seconds() -> float:
    """CPU time so far: of all threads, and of the child processes that have ended."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
