"""Counts of any number of values in fixed bins, with their mean, extremes and quantiles."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import fsum, inf, log10, nan

import numpy as np

from grasp_refine.measures.measures import Unit

BINS_PER_DECADE, LINEAR_BINS = 20, 100
"""Numbers of bins of each power of ten, and of a linear range."""


@dataclass(eq=False)
class Histogram:
    """Histogram that grows by `add`, without non-finite values; the same order gives bit-identical results."""

    low: float
    """Lower edge of the first bin."""
    high: float
    """Upper edge of the last bin."""
    bins: int
    """Number of bins."""
    linear: bool = False
    """Whether bins have the same width; False: the same ratio of their edges."""
    counts: np.ndarray = field(init=False)
    """Numbers of values (bins + 2,) below the bins, in each bin, and above."""
    edges: np.ndarray = field(init=False)
    """Edges (bins + 1,) of the bins."""
    total: float = 0.0
    """Sum of the values."""
    least: float = inf
    """Smallest value."""
    most: float = -inf
    """Largest value."""

    def __post_init__(self) -> None:
        """Begin with empty bins."""
        self.counts = np.zeros(self.bins + 2, dtype=np.int64)
        self.edges = (np.linspace if self.linear else np.geomspace)(self.low, self.high, self.bins + 1)

    @staticmethod
    def of(unit: Unit) -> Histogram:
        """Return the empty histogram of values in a unit.

        There are `BINS_PER_DECADE` bins, so that quantiles are known to 6 %, or, from 0 on, `LINEAR_BINS` in all.
        """
        low, high = unit.span
        if low == 0.0:
            return Histogram(low, high, LINEAR_BINS, linear=True)
        return Histogram(low, high, round(BINS_PER_DECADE * log10(high / low)))

    def add(self, values: np.ndarray) -> None:
        """Count values (N,)."""
        values = values[np.isfinite(values)]
        if not len(values):
            return
        # The last bin includes its upper edge: a quality of 1 is no outlier.
        at = np.where(values == self.edges[-1], self.bins, np.searchsorted(self.edges, values, side="right"))
        self.counts += np.bincount(at, minlength=len(self.counts))
        self.total = fsum((self.total, *values.tolist()))
        self.least, self.most = min(self.least, float(values.min())), max(self.most, float(values.max()))

    @property
    def count(self) -> int:
        """Number of values added."""
        return int(self.counts.sum())

    @property
    def mean(self) -> float:
        """Mean of the values; NaN of none."""
        return self.total / self.count if self.count else nan

    def quantile(self, share: float) -> float:
        """Quantile at a share of all values, to within the width of a bin; NaN of none.

        Below the bins it is the smallest value, above them the largest.
        """
        if not self.count:
            return nan
        reached = np.cumsum(self.counts)
        at = int(np.searchsorted(reached, max(share * self.count, 0.5)))
        if at == 0 or at == len(self.counts) - 1:
            return self.least if at == 0 else self.most
        low, high = self.edges[at - 1 : at + 1]
        within = (share * self.count - reached[at - 1]) / self.counts[at]
        found = low + (high - low) * within if self.linear else low * (high / low) ** within
        return float(np.clip(found, self.least, self.most))

    def shares(self, together: int) -> np.ndarray:
        """Shares of the values below the bins, in each run of `together` bins, and above them."""
        inner = self.counts[1:-1].reshape(-1, together).sum(axis=1)
        return np.array([self.counts[0], *inner, self.counts[-1]]) / max(self.count, 1)
