"""Where the CPU time of a benchmark goes: shares of some stages, and of all others together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from grasp_refine.core.profiling import STAGES, Stage, Stopwatch

REST = "solver"
"""What all is called that is not told apart: loss, linear algebra and accounts of the loop, for the most part."""

Parts = Mapping[str, tuple[Stage, ...]]
"""Name of a part, a word -> its stages."""


def disambiguate(*apart: Stage) -> dict[str, tuple[Stage, ...]]:
    """Each of some stages, and the rest."""
    rest = tuple(stage for stage in STAGES if stage not in apart)
    return {stage.replace(" ", ""): (stage,) for stage in apart} | {REST: rest}


def cpu_share(watches: Sequence[Stopwatch], parts: Parts) -> dict[str, float | None]:
    """The share of each part in the CPU time of all stopwatches; None where they counted nothing."""
    whole = sum(watch.cpu_s for watch in watches)
    return {
        name: sum(watch.spent[stage].cpu_s for watch in watches for stage in stages) / whole if whole > 0 else None
        for name, stages in parts.items()
    }
