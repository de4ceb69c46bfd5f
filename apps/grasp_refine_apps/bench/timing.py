"""CPU times of several ways to do one thing, measured alternately, so that a busy machine disturbs all alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from typing import TypeVar

import numpy as np

from grasp_refine.collision.engine import why_not_native

WARM_UP_CALLS = 2
"""Calls before the first measurement."""

MAX_CALLS = 1000
"""Largest number of calls in a measurement."""

Name = TypeVar("Name", bound=Hashable)


def cpu_times(runs: Mapping[Name, Callable[[], object]], rounds: int, least_s: float) -> dict[Name, np.ndarray]:
    """Measure CPU seconds of a call of each (rounds,), over all threads; element k of all is from the same round.

    Args:
        runs: Name -> the call to measure.
        rounds: Number of measurements of each.
        least_s: Minimum CPU seconds of a measurement, for which short calls are repeated.
    """
    calls = {}
    for name, run in runs.items():
        for _ in range(WARM_UP_CALLS):
            once = _timed(run, 1)
        calls[name] = int(np.clip(np.ceil(least_s / max(once, 1e-7)), 1, MAX_CALLS))
    times = {name: np.empty(rounds) for name in runs}
    for round_ in range(rounds):
        for name, run in runs.items():
            times[name][round_] = _timed(run, calls[name])
    return times


@contextmanager
def one_thread() -> Iterator[None]:
    """Restrict the compiled engine to one thread, like all others: waiting for a second one would count as its time."""
    if why_not_native():
        yield
        return
    from grasp_refine.collision import native_search

    before = native_search._available
    native_search._available = lambda: 1  # type: ignore[assignment]  # replaces a cached function
    try:
        yield
    finally:
        native_search._available = before


def _timed(run: Callable[[], object], calls: int) -> float:
    start = time.process_time()
    for _ in range(calls):
        run()
    return (time.process_time() - start) / calls
