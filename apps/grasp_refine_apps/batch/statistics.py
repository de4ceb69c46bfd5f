"""Statistics of all grasps of a batch: counts, distributions and the worst cases, in bounded memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from grasp_refine.refinement.solvers.status import UNUSABLE as NEVER_REFINED
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.verdict import Agreement
from grasp_refine.validation.measures import RECORDED
from grasp_refine_apps.batch.histogram import Bins, Histogram
from grasp_refine_apps.batch.rows import Rows
from grasp_refine_apps.batch.worst import Case, Worst

UNUSABLE = tuple(status.label for status in NEVER_REFINED)
"""Statuses of grasps that were not refined at all."""

MAX_PAIRS = 5000
"""Maximum number of pairs of hand and object counted separately; of more, those with the fewest failures are not."""
MAX_LISTED_PAIRS = 200
"""Maximum number of pairs listed."""

BINS = {column: Bins.of(measure.unit) for measure in RECORDED for column in measure.columns.values()}
"""Column -> bins of its values."""

SUMMED_FIELDS = (
    *("count", "usable", "converged", "good_before", "good_after"),
    *("simulated", "held_before", "held_after", "gained", "lost", "agreement_before", "agreement_after"),
)
"""Fields of a tally that `merge` adds."""


@dataclass(eq=False)
class Tally:
    """Counts of some grasps."""

    count: int = 0
    """Number of grasps."""
    usable: int = 0
    """Number of grasps refined at all."""
    converged: int = 0
    """Number of grasps that converged."""
    good_before: int = 0
    """Number of grasps with a quality of `HOLDS` or more before."""
    good_after: int = 0
    """Number of grasps with such a quality after."""
    simulated: int = 0
    """Number of grasps simulated."""
    held_before: int = 0
    """Number of simulated grasps that held before."""
    held_after: int = 0
    """Number of simulated grasps that hold after."""
    gained: int = 0
    """Number of grasps that hold after, and did not before."""
    lost: int = 0
    """Number of grasps that held before, and do not after."""
    agreement_before: Agreement = Agreement()
    """Agreement of quality and simulation of the simulated grasps, before."""
    agreement_after: Agreement = Agreement()
    """Agreement of quality and simulation of the simulated grasps, after."""
    quality: tuple[float, float] = (0.0, 0.0)
    """Sums of the qualities before and after, without NaN."""
    rated: tuple[int, int] = (0, 0)
    """Numbers of grasps with a quality, before and after."""
    deepest: float = 0.0
    """Deepest penetration after, metres."""

    def add(self, rows: Rows) -> None:
        """Count grasps."""
        before, after = (rows[f"quality_{when}"] for when in ("before", "after"))
        known = np.isfinite(rows["held_after"])
        held_before, held_after = (rows[f"held_{when}"][known] > 0 for when in ("before", "after"))
        self.merge(
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

    def merge(self, other: Tally) -> None:
        """Add the counts of another tally."""
        for name in SUMMED_FIELDS:
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.quality = self.quality[0] + other.quality[0], self.quality[1] + other.quality[1]
        self.rated = self.rated[0] + other.rated[0], self.rated[1] + other.rated[1]
        self.deepest = max(self.deepest, other.deepest)

    @property
    def mean_quality(self) -> tuple[float, float]:
        """Mean quality before and after; NaN where no grasp has one."""
        before, after = (q / n if n else float("nan") for q, n in zip(self.quality, self.rated, strict=True))
        return before, after

    @property
    def failures(self) -> int:
        """Number of grasps that do not hold: in simulation, where they were simulated, else by their quality."""
        return self.simulated - self.held_after if self.simulated else self.count - self.good_after


@dataclass(frozen=True, eq=False)
class Statistics:
    """Statistics that grow by `add`; the same rows in the same order give the same numbers to the last bit."""

    all: Tally
    """Tally of all grasps."""
    statuses: Counter[str]
    """Counts of the statuses of refinement."""
    reasons: Counter[str]
    """Counts of the reasons why refined grasps did not hold in simulation."""
    distributions: Mapping[str, Histogram]
    """Column -> distribution of its values over the refined grasps."""
    pairs: dict[tuple[str, str], Tally]
    """Hand and object -> tally of their grasps."""
    rest: Tally
    """Tally of the grasps of all other pairs, which are too many to count separately."""
    _worst: Worst = field(default_factory=Worst)

    @staticmethod
    def empty() -> Statistics:
        """Return the statistics of no grasps."""
        distributions = {column: Histogram(bins) for column, bins in BINS.items()}
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
        if len(self.pairs) > MAX_PAIRS:
            self._merge_rest()
        self._worst.add(rows, usable)

    def _merge_rest(self) -> None:
        """Merge the half of the pairs with the fewest failures into `rest`; a pair that occurs again begins anew."""
        for pair, _ in _by_failures(self.pairs)[MAX_PAIRS // 2 :]:
            self.rest.merge(self.pairs.pop(pair))

    def by_pair(self, most: int = MAX_LISTED_PAIRS) -> tuple[list[tuple[tuple[str, str], Tally]], Tally]:
        """Tallies by hand and object, those with the most failures first, and a tally of those left out."""
        ranked = _by_failures(self.pairs)
        rest = Tally()
        rest.merge(self.rest)
        for _, tally in ranked[most:]:
            rest.merge(tally)
        return ranked[:most], rest

    def worst(self) -> tuple[Case, ...]:
        """Worst of the refined grasps; see `Worst`."""
        return self._worst.cases()

    @property
    def held(self) -> tuple[int, int] | None:
        """Numbers of grasps that held in simulation before and after; None: none was simulated."""
        return (self.all.held_before, self.all.held_after) if self.all.simulated else None

    def totals(self) -> dict[str, Any]:
        """Counts of the JSON summary."""
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
