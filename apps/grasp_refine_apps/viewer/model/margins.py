"""Margins of one grasp as data and as text: how often it holds in drawn worlds, and its limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from grasp_refine.results.margins_table import LIMITS


@dataclass(frozen=True)
class HoldingMargins:
    """Margins of one grasp, as `refine-grasp validate --margins` finds them."""

    count: int
    """Number of drawn worlds."""
    probability: float
    """Share of them in which the grasp holds."""
    interval: tuple[float, float]
    """95 % confidence interval of that share."""
    worst: str
    """Factor that costs most alone; empty: none costs anything."""
    worst_probability: float
    """Share of worlds in which the grasp holds where this factor alone is drawn; NaN: none costs anything."""
    limits: Mapping[str, float]
    """Known limits: `Limit.name` -> value in its unit."""

    @property
    def text(self) -> str:
        """The margins in one or two sentences."""
        share, low, high, alone = (f"{100 * p:.0f}" for p in (self.probability, *self.interval, self.worst_probability))
        parts = [f"holds in {share} % of {self.count} drawn worlds (95 % interval {low} to {high} %)"]
        if self.worst:
            parts.append(f"{self.worst} costs most: {alone} % with it alone")
        known = [limit for limit in LIMITS if limit.name in self.limits]
        if known:
            values = (f"{limit.title} {limit.text(self.limits[limit.name])} {limit.unit}".rstrip() for limit in known)
            parts.append(", ".join(values))
        return "; ".join(parts)
