"""Counts of the changes of grasps by refinement, and of good inputs that moved nevertheless."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from typing import Any

import numpy as np
from rich.text import Text

from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.plurals import count_text, whole
from grasp_refine.measures.change import MOVED_M, Change
from grasp_refine.results.outcome import Outcome


@dataclass(frozen=True)
class Changed:
    """Changes of some grasps, counted."""

    counts: Mapping[str, int]
    """Number of grasps by `Change`."""
    confidence: float
    """Quality from which an input grasp is good enough, as `Config.confidence`."""
    good: int
    """Number of refined grasps whose input was good enough."""
    moved: int
    """Number of these with a displacement above `MOVED_M`."""
    median_m: float
    """Median of the displacements of good inputs, metres; NaN: there are none."""
    error_m: float = nan
    """Median contact error before refinement of the good inputs that moved, metres: why they moved. NaN: not known."""

    @staticmethod
    def of(outcome: Outcome, confidence: float) -> Changed:
        """Return the counts of an outcome."""
        good = good_inputs(outcome.change != "", outcome.quality[:, 0], confidence)
        moved = good & (outcome["displacement_m"] > MOVED_M)
        median, error = (
            float(np.nanmedian(values)) if np.isfinite(values).any() else nan
            for values in (outcome["displacement_m"][good], outcome["contact_error_m"][moved, 0])
        )
        counts = Counter(outcome.change.tolist())
        return Changed(counts, confidence, int(good.sum()), int(moved.sum()), median, error)

    def lines(self) -> list[Text]:
        """Return the counts in words; no line on what there is none of."""
        counts = ", ".join(f"{whole(self.counts[each])} {each}" for each in Change if self.counts.get(each))
        found = [Text(f"change: {counts}")] if counts else []
        if self.good:
            color = "yellow" if self.moved else "green"
            found.append(
                Text.assemble(
                    f"{count_text(self.good, 'input grasp')} of quality {self.confidence:g} or more: ",
                    (f"{whole(self.moved)} moved by over {1e3 * MOVED_M:g} mm", color),
                    f" (median {1e3 * self.median_m:.1f} mm)",
                    f", whose contacts were off by {1e3 * self.error_m:.1f} mm" if self.error_m > 0.0 else "",
                )
            )
        return found

    def entry(self) -> dict[str, Any]:
        """Return the counts for JSON."""
        return {
            "changes": {each.value: self.counts.get(each, 0) for each in Change},
            "good_inputs": self.good,
            "good_inputs_moved": self.moved,
            "good_inputs_displacement_median_m": self.median_m,
        }


def good_inputs(
    usable: Bool[np.ndarray, " N"], quality: Float[np.ndarray, " N"], confidence: float
) -> Bool[np.ndarray, " N"]:
    """Return True for grasps (N,) that were refined though their input was good enough, by its quality (N,)."""
    return usable & (np.nan_to_num(quality) >= confidence)
