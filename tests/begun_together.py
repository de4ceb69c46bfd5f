"""Works for tests of processes that begin together; the processes import this file."""

from __future__ import annotations

import os
import time
from collections.abc import Callable


def waits(seconds: float, ready: Callable[[], None]) -> tuple[int, float, float]:
    """Its process, and when it was ready and when it began."""
    time.sleep(seconds)
    at = time.perf_counter()
    ready()
    return os.getpid(), at, time.perf_counter()


def fails(ready: Callable[[], None]) -> None:
    """Raises before it is ready."""
    raise ValueError("no luck")


def dies_early(ready: Callable[[], None]) -> None:
    """Ends its process before it is ready, without a word to those that wait."""
    os._exit(7)
