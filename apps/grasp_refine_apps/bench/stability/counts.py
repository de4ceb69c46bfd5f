"""Counts of several cells together, and groups of rows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from grasp_refine_apps.bench.stability.cases import DTYPES
from grasp_refine_apps.bench.stability.rows import WRONG, Row

SUMMED = ("queries", "refused", "points_compared", "collapsed", "mujoco_queries", "mujoco_wrong", *WRONG)
"""Counts of rows that add up."""

LARGEST = ("error_max", "distance_error_max_m", "points_error_max", "derivative_error_max")
"""Errors of rows of which the largest counts."""

RELATIVE_ERRORS = ("error_max", "points_error_max", "derivative_error_max")
"""Errors that are relative to their tolerance."""


@dataclass(frozen=True)
class Counts:
    """Totals of some rows."""

    cells: int
    """Number of rows."""
    sums: dict[str, int]
    """Each of `SUMMED` -> its sum."""
    largest: dict[str, float | None]
    """Each of `LARGEST` -> the largest; None: nothing was compared."""

    def __getitem__(self, name: str) -> int:
        """Return one of the sums."""
        return self.sums[name]

    @property
    def wrong(self) -> int:
        """Number of faults; a query may have several."""
        return sum(self.sums[name] for name in WRONG)


def total_counts(rows: Iterable[Row]) -> Counts:
    """Total the counts of all rows."""
    rows = list(rows)
    return Counts(
        len(rows),
        {name: sum(row[name] for row in rows) for name in SUMMED},
        {name: max((row[name] for row in rows if row[name] is not None), default=None) for name in LARGEST},
    )


def wrong(row: Row) -> int:
    """Number of faults in a cell; a query may have several."""
    return sum(row[name] for name in WRONG)


def group_rows(rows: Iterable[Row], keys: Sequence[str]) -> dict[tuple[object, ...], list[Row]]:
    """Group rows by the values of the keys."""
    found: dict[tuple[object, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), []).append(row)
    return found


def of_measure(rows: Iterable[Row], measure: str) -> list[Row]:
    """Select the rows on queries ("forward") or on derivatives."""
    return [row for row in rows if row["measure"] == measure]


def worst(rows: Iterable[Row], most: int, nearest: int) -> list[Row]:
    """Select the row with the most faults of each body kind, state, measure and precision, the worst first.

    Args:
        rows: All rows.
        most: Largest number of rows.
        nearest: Largest number of rows of each precision if nothing is wrong; then those with the largest errors are
            the worst. Each precision has its own, because tolerances include the rounding of float32 poses.
    """

    def order(row: Row) -> tuple[int, float]:
        return wrong(row), error_of(row) or 0.0

    each = [max(its, key=order) for its in group_rows(rows, ("kind", "state", "measure", "dtype")).values()]
    each = sorted((row for row in each if order(row) > (0, 0.0)), key=order, reverse=True)
    if each and wrong(each[0]):
        return [row for row in each if wrong(row)][:most]
    precise = group_rows(each, ("dtype",))
    return [row for dtype in DTYPES for row in precise.get((dtype,), [])[:nearest]]


def error_of(row: Row) -> float | None:
    """Largest error of a cell over its tolerance, of all that were compared; None: nothing was."""
    return max((row[name] for name in RELATIVE_ERRORS if row[name] is not None), default=None)
