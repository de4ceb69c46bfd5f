"""Rows of the benchmark, one flat entry with counts for each cell, of queries or of derivatives; and their totals."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Literal

from grasp_refine_apps.bench.chart import Row, group_rows
from grasp_refine_apps.bench.stability.cases import DTYPES

Measure = Literal["forward", "derivative"]

FAULT_LABELS = MappingProxyType(
    {
        "failed": "no answer",
        "not_finite": "not finite",
        "wrong_distance": "wrong distance",
        "wrong_sign": "wrong sign",
        "wrong_points": "wrong points",
        "derivative_not_finite": "derivative not finite",
        "derivative_unbounded": "derivative unbounded",
        "derivative_wrong_sign": "wrong derivative",
        "derivative_unscaled": "derivative does not scale",
    }
)
"""Count that should be 0 -> its label. A refusal is a fault of the input, and faults of MuJoCo are its own."""

WRONG = tuple(FAULT_LABELS)


@dataclass(frozen=True)
class Cell:
    """Counts of all queries of one body kind, size and state, in one way to query."""

    kind: str
    """Kind of bodies."""
    diagonal: float
    """Diagonal of the bounding box of the larger body in metres."""
    state: str
    """Relative state of the bodies."""
    measure: Measure
    """Checked property: distances and points, or their derivatives."""
    dtype: str
    """Precision of the poses: float64 or float32."""
    queries: int
    """Number of queried pairs of poses."""
    batch: int | None = None
    """Poses in one call; None: not varied here."""
    engine: str | None = None
    """Collision engine: native or python; None: not varied here."""
    method: str | None = None
    """Derivative method of the witness points; None: not differentiated."""
    neighborhood: str | None = None
    """Neighbourhood of candidates for the surface; None: not needed."""
    translation: float = 0.0
    """Distance of both bodies from the origin of the world, in metres."""
    refused: int = 0
    """Queries of bodies that could not be built, or of an engine that is not available, see `refusal`."""
    failed: int = 0
    """Queries without an answer, by the status or an error."""
    not_finite: int = 0
    """Answers with a distance, point or normal that is not finite, or finite poses that are reported as not finite."""
    wrong_distance: int = 0
    """Distances further from the reference than the tolerance."""
    wrong_sign: int = 0
    """Distances of the wrong sign where the reference exceeds the tolerance."""
    wrong_points: int = 0
    """Compared witness points farther from the reference than the tolerance; and witness points off the bodies, or not
    the reported distance apart along the normal."""
    points_compared: int = 0
    """Queries whose witness points are unique."""
    collapsed: int = 0
    """Answers within the tolerance with a sign or status other than the reference, whose distance far exceeds rounding:
    gaps that are reported as contact. No fault."""
    error_max: float | None = None
    """Largest error of a distance over its tolerance; None: nothing was compared."""
    distance_error_max_m: float | None = None
    """Largest error of a distance in metres; None: nothing was compared."""
    points_error_max: float | None = None
    """Largest error of witness points and normal over its tolerance; None: nothing was compared."""
    mujoco_queries: int = 0
    """Queries that MuJoCo also answered."""
    mujoco_wrong: int = 0
    """Distances of MuJoCo among these that are wrong by the same measure. Not a fault of ours."""
    derivative_not_finite: int = 0
    """Queries with an entry of the derivative that is not finite."""
    derivative_unbounded: int = 0
    """Queries whose derivative exceeds its bound."""
    derivative_wrong_sign: int = 0
    """Queries whose derivative differs from the true one where known, such as points that move the wrong way."""
    derivative_unscaled: int = 0
    """Queries whose derivative does not follow a change of the unit of length."""
    derivative_error_max: float | None = None
    """Largest error of a derivative over its tolerance; None: nothing was compared."""
    refusal: str | None = None
    """Reason why queries were refused, in one line."""
    where: str | None = None
    """First wrong answer of each pair of bodies; or the error that there was instead of answers."""

    def row(self) -> Row:
        """The entry of the table."""
        return asdict(self)


SUMMED = ("queries", "refused", "points_compared", "collapsed", "mujoco_queries", "mujoco_wrong", *WRONG)
"""Counts of rows that add up."""

LARGEST = ("error_max", "distance_error_max_m", "points_error_max", "derivative_error_max")
"""Errors of rows; the largest counts."""

RELATIVE_ERRORS = ("error_max", "points_error_max", "derivative_error_max")
"""Errors that are relative to their tolerance."""


def total(rows: Iterable[Row]) -> Row:
    """Return the number of rows as "cells", each of `SUMMED`, all faults as "wrong", and the largest of `LARGEST`."""
    rows = list(rows)
    sums = {name: sum(row[name] for row in rows) for name in SUMMED}
    largest = {name: max((row[name] for row in rows if row[name] is not None), default=None) for name in LARGEST}
    return {"cells": len(rows), **sums, "wrong": sum(sums[name] for name in WRONG), **largest}


def wrong(row: Row) -> int:
    """Number of faults in a cell; a query may have several."""
    return sum(row[name] for name in WRONG)


def of_measure(rows: Iterable[Row], measure: str) -> list[Row]:
    """Select the rows on queries ("forward") or on derivatives."""
    return [row for row in rows if row["measure"] == measure]


def worst(rows: Iterable[Row], most: int, nearest: int) -> list[Row]:
    """Select the row with the most faults of each body kind, state, measure and precision, the worst first.

    Args:
        rows: All rows.
        most: Largest number of rows.
        nearest: Largest number of rows of each precision if nothing is wrong; then the rows with the largest errors
            are the worst. Each precision has its own, because tolerances include the rounding of float32 poses.
    """

    def order(row: Row) -> tuple[int, float]:
        return wrong(row), error_of(row) or 0.0

    each = [max(group, key=order) for group in group_rows(rows, ("kind", "state", "measure", "dtype")).values()]
    each = sorted((row for row in each if order(row) > (0, 0.0)), key=order, reverse=True)
    if each and wrong(each[0]):
        return [row for row in each if wrong(row)][:most]
    precise = group_rows(each, ("dtype",))
    return [row for dtype in DTYPES for row in precise.get((dtype,), [])[:nearest]]


def error_of(row: Row) -> float | None:
    """Largest error of a cell over its tolerance, of all that were compared; None: nothing was."""
    return max((row[name] for name in RELATIVE_ERRORS if row[name] is not None), default=None)
