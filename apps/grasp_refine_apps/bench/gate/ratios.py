"""Ratios of the gate: numbers that are equal on any machine, and how much worse each may get."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Literal

Group = Literal["queries", "grasps", "forces"]
"""Ratios that are measured together."""


@dataclass(frozen=True)
class Ratio:
    """A number that does not depend on the speed of the machine."""

    name: str
    """Name in the baseline."""
    what: str
    """Explanation for people."""
    group: Group
    higher: bool = False
    """Whether larger values are better."""
    factor: float = 1.0
    """Allowed factor over the baseline: CPU times of a busy machine differ by a quarter."""
    slack: float = 0.0
    """Allowed difference besides: for shares, and for counts that rounding may change."""
    native: bool = False
    """Whether it exists only with the compiled engine."""
    own: bool = False
    """Whether it is relative to our own code, so that it gets worse when that gets better."""
    promised: float | None = None
    """An absolute limit besides, independent of the baseline."""

    def limit(self, value: float) -> float:
        """Return the worst allowed value for the baseline `value`."""
        limit = value / self.factor - self.slack if self.higher else value * self.factor + self.slack
        if self.promised is None:
            return limit
        return max(limit, self.promised) if self.higher else min(limit, self.promised)

    def allowed(self, now: float, limit: float) -> bool:
        """Return True where a measured value is within its limit; a value that is not finite never is."""
        return isfinite(now) and (now >= limit if self.higher else now <= limit)

    def better(self, one: float, other: float) -> float:
        """Return the better of two measurements."""
        return max(one, other) if self.higher else min(one, other)


TIME_FACTOR, COUNT_FACTOR = 1.5, 1.1
"""Factors of ratios of CPU times, and of counts."""

RATIOS = (
    Ratio("convex-query", "query of two convex bodies / coal.distance", "queries", factor=TIME_FACTOR),
    Ratio("concave-query", "query of 16 x 16 pieces / coal.distance on all pairs", "queries", factor=TIME_FACTOR),
    Ratio("concave-asked", "pieces queried of 256 pairs", "queries", factor=COUNT_FACTOR, slack=0.1),
    Ratio("warm-asked", "pieces queried near the last pose / without it", "queries", factor=COUNT_FACTOR, own=True),
    Ratio("warm-query", "query near the last pose / without it", "queries", factor=TIME_FACTOR, own=True),
    Ratio("single-query", "query at batch 1 / at batch 256", "queries", factor=TIME_FACTOR, own=True),
    Ratio("backward", "backward pass of the witness layer / forward", "queries", factor=TIME_FACTOR, own=True),
    Ratio(
        "engines",
        "query in Python / in the compiled engine",
        "queries",
        higher=True,
        factor=TIME_FACTOR,
        native=True,
        own=True,
        promised=3.0,
    ),
    Ratio(
        "bare-loop",
        "query in the compiled engine / its bare loop",
        "queries",
        factor=TIME_FACTOR,
        native=True,
        promised=2.0,
    ),
    Ratio("grasp", "grasp at batch 64 / 100 queries of coal.distance", "grasps", factor=TIME_FACTOR),
    Ratio("single-grasp", "grasp at batch 1 / at batch 256", "grasps", factor=TIME_FACTOR, own=True),
    Ratio("pieces", "grasp of an object in 64 pieces / in one", "grasps", factor=TIME_FACTOR, own=True),
    Ratio("descent-step", "step of descent / of Levenberg-Marquardt", "grasps", factor=TIME_FACTOR, own=True),
    Ratio("bookkeeping", "share of CPU time in no query, pose or derivative", "grasps", slack=0.08, own=True),
    Ratio("steps", "steps of a grasp, mean", "grasps", factor=COUNT_FACTOR),
    Ratio("queries", "narrow-phase queries of a grasp, mean", "grasps", factor=COUNT_FACTOR),
    Ratio("solved", "share of grasps within 1 mm of all targets", "grasps", higher=True, slack=0.01),
    Ratio("solved-finely", "share within 0.1 mm", "grasps", higher=True, slack=0.03),
    Ratio("holding", "grasp with forces that balance / by geometry only", "forces", factor=TIME_FACTOR, own=True),
    Ratio("good", "share of grasps that should hold", "forces", higher=True, slack=0.07),
)
"""All ratios, in the order of the table."""
