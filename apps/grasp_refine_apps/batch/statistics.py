"""Statistics of all grasps of a batch: counts, distributions and the worst cases, in bounded memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from math import nan
from typing import Any

import numpy as np

from grasp_refine.measures.change import MOVED_M
from grasp_refine.measures.measures import METRE, RECORDED, SIDES
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.status import UNUSABLE as NEVER_REFINED
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.results.changed import Changed, good_inputs
from grasp_refine.results.verdict import Agreement
from grasp_refine_apps.batch.histogram import Histogram
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
    gained: int = 0
    """Number of grasps that hold after, and did not before."""
    lost: int = 0
    """Number of grasps that held before, and do not after."""
    good: np.ndarray = field(default_factory=lambda: np.zeros(2, dtype=int))
    """Numbers of grasps (2,) with a quality of `HOLDS` or more, before and after."""
    rated: np.ndarray = field(default_factory=lambda: np.zeros(2, dtype=int))
    """Numbers of grasps (2,) with a quality, before and after."""
    quality: np.ndarray = field(default_factory=lambda: np.zeros(2))
    """Sums of the qualities (2,) before and after, without NaN."""
    agreement: np.ndarray = field(default_factory=lambda: np.array([Agreement(), Agreement()]))
    """`Agreement` (2,) of quality and simulation of the simulated grasps, before and after."""
    deepest: float = 0.0
    """Deepest penetration after, metres."""

    def add(self, rows: Rows) -> None:
        """Count grasps."""
        known = np.isfinite(rows["held_after"])
        good, held, quality = (
            np.stack([rows[f"{name}_{side}"] for side in SIDES]) for name in ("good", "held", "quality")
        )
        good, held = good > 0, held[:, known] > 0
        before, after = held
        self.merge(
            Tally(
                count=len(rows),
                usable=int((~np.isin(rows["status"], UNUSABLE)).sum()),
                converged=int((rows["status"] == Status.CONVERGED.label).sum()),
                gained=int((after & ~before).sum()),
                lost=int((before & ~after).sum()),
                good=good.sum(axis=1),
                rated=np.isfinite(quality).sum(axis=1),
                quality=np.array([np.nansum(values) for values in quality]),
                agreement=np.array(
                    [Agreement.of(*both) for both in zip(good[:, known] > 0, (before, after), strict=True)]
                ),
                deepest=float(np.nanmax(rows["penetration_m_after"], initial=0.0)),
            )
        )

    def merge(self, other: Tally) -> None:
        """Add the counts of another tally."""
        for each in fields(self):
            own, theirs = getattr(self, each.name), getattr(other, each.name)
            setattr(self, each.name, max(own, theirs) if each.name == "deepest" else own + theirs)

    @property
    def simulated(self) -> int:
        """Number of grasps simulated."""
        return self.agreement[1].count

    @property
    def held(self) -> tuple[int, int]:
        """Numbers of simulated grasps that held before and that hold after."""
        return self.agreement[0].held, self.agreement[1].held

    @property
    def mean_quality(self) -> tuple[float, float]:
        """Mean quality before and after; NaN where no grasp has one."""
        before, after = (q / n if n else nan for q, n in zip(self.quality.tolist(), self.rated.tolist(), strict=True))
        return before, after

    @property
    def failures(self) -> int:
        """Number of grasps that do not hold: in simulation, where they were simulated, else by their quality."""
        return self.simulated - self.held[1] if self.simulated else self.count - int(self.good[1])


@dataclass(eq=False)
class GoodInputs:
    """Displacements of the refined grasps whose input was good enough."""

    confidence: float
    """Quality from which an input grasp is good enough, as `Config.confidence`."""
    moved: int = 0
    """Number of grasps with a displacement above `MOVED_M`."""
    displacement: Histogram = field(default_factory=lambda: Histogram.of(METRE))
    """Distribution of the displacements."""

    def add(self, rows: Rows) -> None:
        """Count grasps."""
        values = rows["displacement_m"][good_inputs(rows["change"] != "", rows["quality_before"], self.confidence)]
        self.moved += int((values > MOVED_M).sum())
        self.displacement.add(values)


@dataclass(frozen=True, eq=False)
class Statistics:
    """Statistics that grow by `add`; the same rows in the same order give the same numbers to the last bit."""

    all: Tally
    """Tally of all grasps."""
    statuses: Counter[str]
    """Counts of the statuses of refinement."""
    changes: Counter[str]
    """Counts of the changes of grasps."""
    good_inputs: GoodInputs
    """Displacements of the grasps that were good enough before."""
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
    def empty(confidence: float = Config.confidence) -> Statistics:
        """Return the statistics of no grasps; `confidence` is that of `Config`."""
        distributions = {entry: Histogram.of(one.unit) for one in RECORDED for entry in one.entries.values()}
        good = GoodInputs(confidence)
        return Statistics(Tally(), Counter(), Counter(), good, Counter(), distributions, {}, Tally())

    def add(self, rows: Rows) -> None:
        """Count the grasps of a result file."""
        if not len(rows):
            return
        self.all.add(rows)
        self.statuses.update(rows["status"].tolist())
        self.changes.update(rows["change"].tolist())
        self.good_inputs.add(rows)
        self.reasons.update(filter(None, rows["reason_after"].tolist()))
        usable = ~np.isin(rows["status"], UNUSABLE)
        for name, histogram in self.distributions.items():
            histogram.add(rows[name][usable])
        hands, objects = rows["hand"].tolist(), rows["object"].tolist()
        for pair in dict.fromkeys(zip(hands, objects, strict=True)):
            of_pair = (rows["hand"] == pair[0]) & (rows["object"] == pair[1])
            part = rows if of_pair.all() else Rows({name: values[of_pair] for name, values in rows.columns.items()})
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
        return self.all.held if self.all.simulated else None

    @property
    def changed(self) -> Changed:
        """Changes of the grasps, counted."""
        good = self.good_inputs
        median = good.displacement.quantile(0.5)
        return Changed(self.changes, good.confidence, good.displacement.count, good.moved, median)

    def totals(self) -> dict[str, Any]:
        """Counts of the JSON summary."""
        before, after = self.held or (None, None)
        return {
            "n": self.all.count,
            "converged": self.all.converged,
            **{f"good_{side}": int(count) for side, count in zip(SIDES, self.all.good, strict=True)},
            **self.changed.entry(),
            "success_before": before,
            "success_after": after,
        }


def _by_failures(pairs: Mapping[tuple[str, str], Tally]) -> list[tuple[tuple[str, str], Tally]]:
    return sorted(pairs.items(), key=lambda entry: (-entry[1].failures, -entry[1].count, entry[0]))
