"""Counts of several cells together, and which rows belong together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from grasp_refine_apps.bench.stability.cases import DTYPES
from grasp_refine_apps.bench.stability.rows import WRONG, Row

SUMMED = ("queries", "refused", "points_compared", "collapsed", "mujoco_queries", "mujoco_wrong", *WRONG)
"""Counts of rows that add up."""

WORST = ("error_max", "distance_error_max_m", "points_error_max", "derivative_error_max")
"""Of these the largest counts."""

SHARES = ("error_max", "points_error_max", "derivative_error_max")
"""Those that are over their tolerance."""


@dataclass(frozen=True)
class Counts:
    """What came of some rows."""

    cells: int
    """How many rows there are."""
    sums: dict[str, int]
    """Each of `SUMMED` -> all of them."""
    largest: dict[str, float | None]
    """Each of `WORST` -> the largest; None: nothing was compared."""

    def __getitem__(self, name: str) -> int:
        """One of the sums."""
        return self.sums[name]

    @property
    def wrong(self) -> int:
        """How many faults there were; a query may have several."""
        return sum(self.sums[name] for name in WRONG)


def counted(rows: Iterable[Row]) -> Counts:
    """All of the rows together."""
    rows = list(rows)
    return Counts(
        len(rows),
        {name: sum(row[name] for row in rows) for name in SUMMED},
        {name: max((row[name] for row in rows if row[name] is not None), default=None) for name in WORST},
    )


def wrong(row: Row) -> int:
    """How many faults there were in a cell; a query may have several."""
    return sum(row[name] for name in WRONG)


def grouped(rows: Iterable[Row], keys: Sequence[str]) -> dict[tuple[object, ...], list[Row]]:
    """Values of the keys -> the rows that have them."""
    found: dict[tuple[object, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), []).append(row)
    return found


def of_measure(rows: Iterable[Row], measure: str) -> list[Row]:
    """The rows on queries ("forward") or on derivatives."""
    return [row for row in rows if row["measure"] == measure]


def worst(rows: Iterable[Row], most: int, nearest: int) -> list[Row]:
    """Of each body kind, state, measure and precision the row with the most faults, the worst first.

    Args:
        rows: All rows.
        most: So many rows at most.
        nearest: So many of each precision at most if nothing is wrong at all; then those with the largest errors are
            the worst. Each precision has its own, because tolerances are of the rounding of float32 poses.
    """

    def order(row: Row) -> tuple[int, float]:
        return wrong(row), error_of(row) or 0.0

    each = [max(its, key=order) for its in grouped(rows, ("kind", "state", "measure", "dtype")).values()]
    each = sorted((row for row in each if order(row) > (0, 0.0)), key=order, reverse=True)
    if each and wrong(each[0]):
        return [row for row in each if wrong(row)][:most]
    precise = grouped(each, ("dtype",))
    return [row for dtype in DTYPES for row in precise.get((dtype,), [])[:nearest]]


def error_of(row: Row) -> float | None:
    """The largest error of a cell over its tolerance, of whatever was compared; None: nothing was."""
    return max((row[name] for name in SHARES if row[name] is not None), default=None)
