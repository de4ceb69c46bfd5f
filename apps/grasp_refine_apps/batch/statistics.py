"""What is told of all grasps of a batch: counts, distributions and the worst cases, in memory that does not grow."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from grasp_refine.refinement.solvers.status import UNUSABLE as NEVER_REFINED
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.verdict import Agreement
from grasp_refine_apps.batch.histogram import LINEAR, Bins, Histogram
from grasp_refine_apps.batch.rows import Rows
from grasp_refine_apps.batch.worst import Case, Worst

UNUSABLE = tuple(status.label for status in NEVER_REFINED)
"""Statuses of grasps that were not refined at all."""

PAIRS = 5000
"""Most pairs of hand and object that are counted each on its own; of more, those with the fewest failures are not."""
SHOWN = 200
"""Most pairs that are told of."""

LENGTH = Bins(1e-7, 1.0, 140)
MEASURES: Mapping[str, Bins] = {
    "quality_before": Bins(0.0, 1.0, 100, LINEAR),
    "quality_after": Bins(0.0, 1.0, 100, LINEAR),
    "wrench_residual_before": Bins(1e-5, 10.0, 120),
    "wrench_residual_after": Bins(1e-5, 10.0, 120),
    "contact_error_before_m": LENGTH,
    "contact_error_after_m": LENGTH,
    "penetration_before_m": LENGTH,
    "penetration_after_m": LENGTH,
    "self_penetration_before_m": LENGTH,
    "self_penetration_after_m": LENGTH,
    "moved_palm_m": LENGTH,
    "moved_palm_rad": Bins(1e-5, 10.0, 120),
    "moved_joints_rad": Bins(1e-5, 10.0, 120),
    "iterations": Bins(1.0, 1e5, 100),
    "cpu_s": Bins(1e-4, 1e4, 160),
}
"""Column -> bins in which its values are counted; twenty to a power of ten, so that quantiles are known to 6 %."""

SUMS = (
    *("count", "usable", "converged", "good_before", "good_after"),
    *("simulated", "held_before", "held_after", "gained", "lost", "agreement_before", "agreement_after"),
)
"""Fields of a tally that are added up as they are."""


@dataclass(eq=False)
class Tally:
    """Counts of some grasps."""

    count: int = 0
    """How many there are."""
    usable: int = 0
    """How many were refined at all."""
    converged: int = 0
    """How many converged."""
    good_before: int = 0
    """How many had a quality of `HOLDS` or more before."""
    good_after: int = 0
    """How many have it now."""
    simulated: int = 0
    """How many were simulated."""
    held_before: int = 0
    """How many of these held before."""
    held_after: int = 0
    """How many of these hold now."""
    gained: int = 0
    """How many hold now that did not before."""
    lost: int = 0
    """How many held before and do not now."""
    agreement_before: Agreement = Agreement()
    """Quality and simulation of those that were simulated, before."""
    agreement_after: Agreement = Agreement()
    """The same, now."""
    quality: tuple[float, float] = (0.0, 0.0)
    """Sums of the quality before and after, of those that have one."""
    rated: tuple[int, int] = (0, 0)
    """How many have one."""
    deepest: float = 0.0
    """The deepest penetration after, metres."""

    def add(self, rows: Rows) -> None:
        """Count grasps."""
        before, after = (rows[f"quality_{when}"] for when in ("before", "after"))
        known = np.isfinite(rows["held_after"])
        held_before, held_after = (rows[f"held_{when}"][known] > 0 for when in ("before", "after"))
        self.more(
            Tally(
                count=len(rows),
                usable=int((~np.isin(rows["status"], UNUSABLE)).sum()),
                converged=int((rows["status"] == Status.CONVERGED.label).sum()),
                good_before=int(rows["good_before"].sum()),
                good_after=int(rows["good_after"].sum()),
                simulated=int(known.sum()),
                held_before=int(held_before.sum()),
                held_after=int(held_after.sum()),
                gained=int((held_after & ~held_before).sum()),
                lost=int((held_before & ~held_after).sum()),
                agreement_before=Agreement.of(rows["good_before"][known] > 0, held_before),
                agreement_after=Agreement.of(rows["good_after"][known] > 0, held_after),
                quality=(float(np.nansum(before)), float(np.nansum(after))),
                rated=(int(np.isfinite(before).sum()), int(np.isfinite(after).sum())),
                deepest=float(np.nanmax(rows["penetration_after_m"], initial=0.0)),
            )
        )

    def more(self, other: Tally) -> None:
        """Count those of another tally, too."""
        for name in SUMS:
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.quality = self.quality[0] + other.quality[0], self.quality[1] + other.quality[1]
        self.rated = self.rated[0] + other.rated[0], self.rated[1] + other.rated[1]
        self.deepest = max(self.deepest, other.deepest)

    @property
    def mean_quality(self) -> tuple[float, float]:
        """Mean quality before and after; NaN where none has one."""
        before, after = (q / n if n else float("nan") for q, n in zip(self.quality, self.rated, strict=True))
        return before, after

    @property
    def failures(self) -> int:
        """How many do not hold: in simulation, where they were simulated, else by their quality."""
        return self.simulated - self.held_after if self.simulated else self.count - self.good_after


@dataclass(frozen=True, eq=False)
class Statistics:
    """Grows by `add`; the same rows in the same order give the same numbers to the last bit."""

    all: Tally
    """Of all grasps."""
    statuses: Counter[str]
    """How refinements ended."""
    reasons: Counter[str]
    """Why refined grasps did not hold in simulation."""
    distributions: Mapping[str, Histogram]
    """Column -> distribution of its values, of the grasps that were refined."""
    pairs: dict[tuple[str, str], Tally]
    """Hand and object -> their grasps."""
    rest: Tally
    """Grasps of pairs which are too many to count each on its own."""
    _worst: Worst = field(default_factory=Worst)

    @staticmethod
    def empty() -> Statistics:
        """Of no grasps."""
        distributions = {name: Histogram(bins) for name, bins in MEASURES.items()}
        return Statistics(Tally(), Counter(), Counter(), distributions, {}, Tally())

    def add(self, rows: Rows) -> None:
        """Count the grasps of a result file."""
        if not len(rows):
            return
        self.all.add(rows)
        self.statuses.update(rows["status"].tolist())
        self.reasons.update(filter(None, rows["reason_after"].tolist()))
        usable = ~np.isin(rows["status"], UNUSABLE)
        for name, histogram in self.distributions.items():
            histogram.add(rows[name][usable])
        hands, objects = rows["hand"].tolist(), rows["object"].tolist()
        for pair in dict.fromkeys(zip(hands, objects, strict=True)):
            its = (rows["hand"] == pair[0]) & (rows["object"] == pair[1])
            part = rows if its.all() else Rows({name: values[its] for name, values in rows.columns.items()})
            self.pairs.setdefault(pair, Tally()).add(part)
        if len(self.pairs) > PAIRS:
            self._pool()
        self._worst.add(rows, usable)

    def _pool(self) -> None:
        """Forget half of the pairs, those that say least; a pair that comes again begins anew."""
        for pair, _ in _by_failures(self.pairs)[PAIRS // 2 :]:
            self.rest.more(self.pairs.pop(pair))

    def by_pair(self, most: int = SHOWN) -> tuple[list[tuple[tuple[str, str], Tally]], Tally]:
        """Hands and objects with their grasps, those with the most failures first, and a tally of those left out."""
        ranked = _by_failures(self.pairs)
        rest = Tally()
        rest.more(self.rest)
        for _, tally in ranked[most:]:
            rest.more(tally)
        return ranked[:most], rest

    def worst(self) -> tuple[Case, ...]:
        """The worst of the grasps that were refined; see `Worst`."""
        return self._worst.cases()

    @property
    def held(self) -> tuple[int, int] | None:
        """How many held in simulation before and after; None: none was simulated."""
        return (self.all.held_before, self.all.held_after) if self.all.simulated else None

    def totals(self) -> dict[str, Any]:
        """The counts of the JSON summary."""
        before, after = self.held or (None, None)
        return {
            "n": self.all.count,
            "converged": self.all.converged,
            "good_before": self.all.good_before,
            "good_after": self.all.good_after,
            "success_before": before,
            "success_after": after,
        }


def _by_failures(pairs: Mapping[tuple[str, str], Tally]) -> list[tuple[tuple[str, str], Tally]]:
    return sorted(pairs.items(), key=lambda entry: (-entry[1].failures, -entry[1].count, entry[0]))
