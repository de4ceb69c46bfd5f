"""Time: CPU times measured alternately, and shares of CPU time by stage."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TypeVar

import numpy as np

from grasp_refine.collision.engine import why_not_native
from grasp_refine.core.profiling import STAGES, Stage, Stopwatch
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.iterate import limited
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

WARM_UP_CALLS = 2
"""Calls before the first measurement; iterations and grasps of a refinement before it."""

MAX_CALLS = 1000
"""Largest number of calls in a measurement."""

REST = "solver"
"""Name of all other stages: mostly loss, linear algebra and bookkeeping of the loop."""

Parts = Mapping[str, tuple[Stage, ...]]
"""Name of a part, one word -> its stages."""

Name = TypeVar("Name", bound=Hashable)


def cpu_times(runs: Mapping[Name, Callable[[], object]], rounds: int, least_s: float) -> dict[Name, np.ndarray]:
    """Measure CPU seconds per call (rounds,) of each run, over all threads; elements k are from the same round.

    The calls alternate, so that a busy machine disturbs all alike.

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
    """Restrict the compiled engine to one thread, as all others have: waiting for a second would count as CPU time."""
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


def warmed_up(scene: Scene, configs: Sequence[Config]) -> HandObject:
    """Prepare hand and object, and refine a few grasps briefly, so that no later call builds caches or loads code."""
    prepared, few = HandObject.of(scene), scene.select(slice(WARM_UP_CALLS))
    for config in configs:
        short = replace(config, starts=1, solver=limited(config.solver, iterations=WARM_UP_CALLS))
        refine(few, short, prepared=prepared)
    return prepared


def _timed(run: Callable[[], object], calls: int) -> float:
    start = time.process_time()
    for _ in range(calls):
        run()
    return (time.process_time() - start) / calls


def split_stages(*apart: Stage) -> dict[str, tuple[Stage, ...]]:
    """Return each stage of `apart` as a part, and all other stages as one more part."""
    rest = tuple(stage for stage in STAGES if stage not in apart)
    return {stage.replace(" ", ""): (stage,) for stage in apart} | {REST: rest}


def cpu_share(watches: Sequence[Stopwatch], parts: Parts) -> dict[str, float | None]:
    """Return the share of each part in the CPU time of all stopwatches; None where they counted nothing."""
    whole = sum(watch.cpu_s for watch in watches)
    return {
        name: sum(watch.spent[stage].cpu_s for watch in watches for stage in stages) / whole if whole > 0 else None
        for name, stages in parts.items()
    }
