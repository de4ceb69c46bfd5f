"""Worst grasps of a batch for inspection: least likely to hold, of several hands and objects."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isnan
from pathlib import Path

import numpy as np

from grasp_refine.measures.measures import COMPARED
from grasp_refine_apps.batch.rows import Rows

NUM_CASES = 12
"""Number of cases shown."""
MAX_CASES_PER_PAIR = 3
"""Maximum number of cases of one hand and object, as long as there are others."""
MAX_KEPT = 240
"""Number of cases kept, from which the shown cases are chosen."""


@dataclass(frozen=True)
class Case:
    """A refined grasp, and its place in the results."""

    shard: int
    """Number of the shard."""
    file: Path
    """Result file, relative to the folder of results."""
    row: int
    """Row in the result file."""
    hand: str
    """Name of the hand."""
    object: str
    """Name of the object."""
    scale: float
    """Factor from the object's mesh to metres."""
    source: str
    """Grasp file of the input grasp; empty if the result does not name it."""
    source_row: int | None
    """Row in the grasp file; None: not known."""
    status: str
    """Status of the refinement."""
    measures: Mapping[str, tuple[float, ...]]
    """Name of a measure of `COMPARED` -> its values before and after, SI units; NaN: not known, as without contact.
    Of grasps that were not refined, one value."""
    held: bool | None
    """Whether it held in simulation; None: not simulated."""
    reason: str
    """Reason why it did not hold in simulation; empty if it held or was not simulated."""
    look: tuple[str, ...]
    """Options of `refine-grasp view`, beside file and row, to show it."""

    @property
    def badness(self) -> tuple[bool, float, float, int, int]:
        """Sort key, greatest for the worst case and unique for each case."""
        # A grasp without contact has no quality, and ranks as the worst.
        quality, depth = (self.measures[key][-1] for key in ("quality", "penetration_m"))
        quality, depth = -1.0 if isnan(quality) else quality, 0.0 if isnan(depth) else depth
        return (self.held is not True, -quality, depth, -self.shard, -self.row)


@dataclass(eq=False)
class Worst:
    """Collection of the worst cases that grows by `add`, up to `MAX_KEPT` cases."""

    _heap: list[tuple[tuple[bool, float, float, int, int], Case]] = field(default_factory=list)

    def add(self, rows: Rows, usable: np.ndarray) -> None:
        """Add the grasps of a result file; `usable` (N,) is True for refined ones."""
        quality = np.nan_to_num(rows["quality_after"], nan=-1.0)
        penetration = np.nan_to_num(rows["penetration_m_after"])
        held = rows["held_after"] == 1.0
        order = np.lexsort((rows["row_in_file"], -penetration, quality, held))
        for i in order[usable[order]][:MAX_KEPT].tolist():
            case = case_of(rows, i)
            if len(self._heap) < MAX_KEPT:
                heapq.heappush(self._heap, (case.badness, case))
            elif case.badness > self._heap[0][0]:
                heapq.heapreplace(self._heap, (case.badness, case))
            else:
                # All further ones are even better.
                break

    def cases(self) -> tuple[Case, ...]:
        """Return at most `NUM_CASES`, the worst first.

        Grasps that did not hold in simulation, or were not simulated, come before held grasps; then low quality
        before high, and deep penetration before shallow.
        """
        ranked = [case for _, case in sorted(self._heap, reverse=True)]
        seen: Counter[tuple[str, str]] = Counter()
        first: list[Case] = []
        others: list[Case] = []
        for case in ranked:
            seen[case.hand, case.object] += 1
            (first if seen[case.hand, case.object] <= MAX_CASES_PER_PAIR else others).append(case)
        chosen = (first + others)[:NUM_CASES]
        return tuple(sorted(chosen, key=lambda case: case.badness, reverse=True))


def case_of(rows: Rows, i: int) -> Case:
    """Return row `i` of some rows of the index as a case."""
    held, row = float(rows["held_after"][i]), float(rows["row"][i])
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
        measures={one.name: tuple(float(rows[column][i]) for column in one.entries.values()) for one in COMPARED},
        held=None if isnan(held) else bool(held),
        reason=str(rows["reason_after"][i]),
        look=rows.look,
    )
