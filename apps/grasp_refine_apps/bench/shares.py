"""Shares of the CPU time of a benchmark: by selected stages, and all others together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from grasp_refine.core.profiling import STAGES, Stage, Stopwatch

REST = "solver"
"""Name of all other stages: mostly loss, linear algebra and bookkeeping of the loop."""

Parts = Mapping[str, tuple[Stage, ...]]
"""Name of a part, one word -> its stages."""


def split_stages(*apart: Stage) -> dict[str, tuple[Stage, ...]]:
    """Return each of the given stages as a part, and the rest as one more."""
    rest = tuple(stage for stage in STAGES if stage not in apart)
    return {stage.replace(" ", ""): (stage,) for stage in apart} | {REST: rest}


def cpu_share(watches: Sequence[Stopwatch], parts: Parts) -> dict[str, float | None]:
    """Return the share of each part in the CPU time of all stopwatches; None where they counted nothing."""
    whole = sum(watch.cpu_s for watch in watches)
    return {
        name: sum(watch.spent[stage].cpu_s for watch in watches for stage in stages) / whole if whole > 0 else None
        for name, stages in parts.items()
    }
