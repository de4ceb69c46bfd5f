"""The worst grasps of a batch, to be looked at: those that are least likely to hold, of several hands and objects."""

from __future__ import annotations

import heapq
from collections import Counter
from dataclasses import dataclass, field
from math import isnan
from pathlib import Path

import numpy as np

from grasp_refine_apps.batch.rows import Rows

CASES = 12
"""So many are shown,"""
ALIKE = 3
"""and no more than so many of one hand and object, as long as there are others."""
KEPT = 240
"""So many are remembered, of which these are chosen."""


@dataclass(frozen=True)
class Case:
    """A refined grasp, and where it is to be found."""

    shard: int
    """Number of its shard."""
    file: Path
    """Its result file, relative to the folder of results."""
    row: int
    """Its row there."""
    hand: str
    """Name of the hand."""
    object: str
    """Name of the object."""
    scale: float
    """What takes the object's mesh to metres."""
    source: str
    """The grasp file that it comes from; empty where the result does not say it."""
    source_row: int | None
    """Its row there."""
    status: str
    """How its refinement ended."""
    quality: tuple[float, float]
    """Before and after; NaN: none, because nothing touches."""
    penetration_m: tuple[float, float]
    """Before and after, metres."""
    contact_error_m: tuple[float, float]
    """Before and after, metres; NaN where nothing touches."""
    held: bool | None
    """Whether it held in simulation; None: not simulated."""
    reason: str
    """Why not."""
    look: tuple[str, ...]
    """What `refine-grasp view` needs to be told beside file and row to show it."""

    @property
    def badness(self) -> tuple[bool, float, float, int, int]:
        """By what cases are ranked, the worst being greatest; no two are alike."""
        # A grasp that does not hold although it should is worth a look before one of which this was said.
        quality = -1.0 if isnan(self.quality[1]) else self.quality[1]
        return (self.held is not True, -quality, self.penetration_m[1], -self.shard, -self.row)


@dataclass(eq=False)
class Worst:
    """Grows by `add`, up to `KEPT` cases."""

    _heap: list[tuple[tuple[bool, float, float, int, int], Case]] = field(default_factory=list)

    def add(self, rows: Rows, usable: np.ndarray) -> None:
        """Look through the grasps of a result file of which some (N,) were refined."""
        quality = np.nan_to_num(rows["quality_after"], nan=-1.0)
        penetration = np.nan_to_num(rows["penetration_after_m"])
        held = rows["held_after"] == 1.0
        order = np.lexsort((rows["row_in_file"], -penetration, quality, held))
        for i in order[usable[order]][:KEPT].tolist():
            case = _case(rows, i)
            if len(self._heap) < KEPT:
                heapq.heappush(self._heap, (case.badness, case))
            elif case.badness > self._heap[0][0]:
                heapq.heapreplace(self._heap, (case.badness, case))
            else:
                # The others are better still.
                break

    def cases(self) -> tuple[Case, ...]:
        """At most `CASES`, the worst first.

        What did not hold in simulation, or was not simulated, comes before what held; then low quality comes before
        high, and deep penetration before shallow.
        """
        ranked = [case for _, case in sorted(self._heap, reverse=True)]
        seen: Counter[tuple[str, str]] = Counter()
        first: list[Case] = []
        others: list[Case] = []
        for case in ranked:
            seen[case.hand, case.object] += 1
            (first if seen[case.hand, case.object] <= ALIKE else others).append(case)
        chosen = (first + others)[:CASES]
        return tuple(sorted(chosen, key=lambda case: case.badness, reverse=True))


def _case(rows: Rows, i: int) -> Case:
    def both(name: str, unit: str = "") -> tuple[float, float]:
        return float(rows[f"{name}_before{unit}"][i]), float(rows[f"{name}_after{unit}"][i])

    held, row = float(rows["held_after"][i]), float(rows["row"][i])
    before, after = both("penetration", "_m")
    return Case(
        shard=int(rows["shard"][i]),
        file=Path(str(rows["file"][i])),
        row=int(rows["row_in_file"][i]),
        hand=str(rows["hand"][i]),
        object=str(rows["object"][i]),
        scale=float(rows["scale"][i]),
        source=str(rows["source"][i]),
        source_row=None if isnan(row) else int(row),
        status=str(rows["status"][i]),
        quality=both("quality"),
        penetration_m=(0.0 if isnan(before) else before, 0.0 if isnan(after) else after),
        contact_error_m=both("contact_error", "_m"),
        held=None if isnan(held) else bool(held),
        reason=str(rows["reason_after"][i]),
        look=rows.look,
    )
