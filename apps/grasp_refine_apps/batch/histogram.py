"""Counts of any number of values in fixed bins, with their mean, extremes and quantiles."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import fsum, inf, nan

import numpy as np

LINEAR, LOGARITHMIC = "linear", "logarithmic"


@dataclass(frozen=True)
class Bins:
    """Where bins begin and end, and how the axis is marked."""

    low: float
    """Where the first one begins."""
    high: float
    """Where the last one ends."""
    count: int
    """How many there are."""
    scale: str = LOGARITHMIC
    """LINEAR or LOGARITHMIC."""

    @property
    def edges(self) -> np.ndarray:
        """Their (count + 1,) edges."""
        space = np.geomspace if self.scale == LOGARITHMIC else np.linspace
        return space(self.low, self.high, self.count + 1)


@dataclass(eq=False)
class Histogram:
    """Grows by `add`; what is not finite is left out. Fed in the same order, it says the same to the last bit."""

    bins: Bins
    counts: np.ndarray = field(init=False)
    """So many values (count + 2,) below the bins, in each, and above."""
    total: float = 0.0
    """Their sum."""
    least: float = inf
    """The smallest value."""
    most: float = -inf
    """The largest value."""

    def __post_init__(self) -> None:
        """Begin with nothing."""
        self.counts = np.zeros(self.bins.count + 2, dtype=np.int64)
        self._edges = self.bins.edges

    def add(self, values: np.ndarray) -> None:
        """Count values (N,)."""
        values = values[np.isfinite(values)]
        if not len(values):
            return
        # The last bin holds its end, too: a quality of 1 is no outlier.
        at = np.where(values == self._edges[-1], self.bins.count, np.searchsorted(self._edges, values, side="right"))
        self.counts += np.bincount(at, minlength=len(self.counts))
        self.total = fsum((self.total, *values.tolist()))
        self.least, self.most = min(self.least, float(values.min())), max(self.most, float(values.max()))

    @property
    def count(self) -> int:
        """How many values were added."""
        return int(self.counts.sum())

    @property
    def mean(self) -> float:
        """Their mean; NaN of none."""
        return self.total / self.count if self.count else nan

    def quantile(self, share: float) -> float:
        """The value that a share of all do not exceed, to within the width of a bin; NaN of none.

        Below the bins it is the smallest value, and above them the largest.
        """
        if not self.count:
            return nan
        reached = np.cumsum(self.counts)
        at = int(np.searchsorted(reached, max(share * self.count, 0.5)))
        if at == 0 or at == len(self.counts) - 1:
            return self.least if at == 0 else self.most
        low, high = self._edges[at - 1 : at + 1]
        within = (share * self.count - reached[at - 1]) / self.counts[at]
        found = low * (high / low) ** within if self.bins.scale == LOGARITHMIC else low + (high - low) * within
        return float(np.clip(found, self.least, self.most))

    def shares(self, together: int) -> np.ndarray:
        """Share of the values below the bins, in every so many bins `together`, and above them."""
        inner = self.counts[1:-1].reshape(-1, together).sum(axis=1)
        return np.array([self.counts[0], *inner, self.counts[-1]]) / max(self.count, 1)
