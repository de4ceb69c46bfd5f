"""Statistics of all grasps of a batch: counts, distributions and the worst cases, in bounded memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from math import nan
from typing import Any

import numpy as np

from grasp_refine.measures.measures import RECORDED, SIDES
from grasp_refine.refinement.solvers.status import UNUSABLE as NEVER_REFINED
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.verdict import Agreement
from grasp_refine_apps.batch.histogram import Bins, Histogram
from grasp_refine_apps.batch.rows import Rows
from grasp_refine_apps.batch.worst import Case, Worst

UNUSABLE = tuple(status.label for status in NEVER_REFINED)
"""Statuses of grasps that were not refined at all."""

MAX_PAIRS = 5000
"""Maximum number of pairs of hand and object counted separately; of more, the pairs with the fewest failures are left
out."""
MAX_LISTED_PAIRS = 200
"""Maximum number of pairs listed."""


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
    gained: int = 0
    """Number of grasps that hold after, and did not before."""
    lost: int = 0
    """Number of grasps that held before, and do not after."""
    agreement_before: Agreement = Agreement()
    """Agreement of quality and simulation of the simulated grasps, before."""
    agreement_after: Agreement = Agreement()
    """Agreement of quality and simulation of the simulated grasps, after."""
    quality_before: float = 0.0
    """Sum of the qualities before, without NaN."""
    quality_after: float = 0.0
    """Sum of the qualities after, without NaN."""
    rated_before: int = 0
    """Number of grasps with a quality before."""
    rated_after: int = 0
    """Number of grasps with a quality after."""
    deepest: float = 0.0
    """Deepest penetration after, metres."""

    def add(self, rows: Rows) -> None:
        """Count grasps."""
        known = np.isfinite(rows["held_after"])
        good, quality = ({side: rows[f"{key}_{side}"] for side in SIDES} for key in ("good", "quality"))
        held = {side: rows[f"held_{side}"][known] > 0 for side in SIDES}
        both: dict[str, Any] = {}
        for side in SIDES:
            both |= {
                f"good_{side}": int(good[side].sum()),
                f"agreement_{side}": Agreement.of(good[side][known] > 0, held[side]),
                f"quality_{side}": float(np.nansum(quality[side])),
                f"rated_{side}": int(np.isfinite(quality[side]).sum()),
            }
        self.merge(
            Tally(
                count=len(rows),
                usable=int((~np.isin(rows["status"], UNUSABLE)).sum()),
                converged=int((rows["status"] == Status.CONVERGED.label).sum()),
                gained=int((held["after"] & ~held["before"]).sum()),
                lost=int((held["before"] & ~held["after"]).sum()),
                deepest=float(np.nanmax(rows["penetration_m_after"], initial=0.0)),
                **both,
            )
        )

    def merge(self, other: Tally) -> None:
        """Add the counts of another tally."""
        for each in fields(self):
            own, its = getattr(self, each.name), getattr(other, each.name)
            setattr(self, each.name, max(own, its) if each.name == "deepest" else own + its)

    @property
    def simulated(self) -> int:
        """Number of grasps simulated."""
        return self.agreement_after.count

    @property
    def held_before(self) -> int:
        """Number of simulated grasps that held before."""
        return self.agreement_before.held

    @property
    def held_after(self) -> int:
        """Number of simulated grasps that hold after."""
        return self.agreement_after.held

    @property
    def mean_quality(self) -> tuple[float, float]:
        """Mean quality before and after; NaN where no grasp has one."""
        before = self.quality_before / self.rated_before if self.rated_before else nan
        return before, self.quality_after / self.rated_after if self.rated_after else nan

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
        distributions = {
            column: Histogram(Bins.of(measure.unit)) for measure in RECORDED for column in measure.entries.values()
        }
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
        """Tallies by hand and object, most failures first, and a tally of the rest."""
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
