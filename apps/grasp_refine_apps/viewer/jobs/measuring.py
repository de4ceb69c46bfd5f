"""Measures of grasps whose files have none."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from grasp_refine.core.array_types import Bool, Int
from grasp_refine.measures.metrics import Metrics, metrics_of
from grasp_refine.problem.problem import Group
from grasp_refine_apps.viewer.model.collection import Collection
from grasp_refine_apps.viewer.model.columns import Column, measured_columns, numeric_columns

BATCH_SIZE = 8
"""Number of grasps measured together; measuring can be stopped between batches."""


def unmeasured(collection: Collection) -> Bool[np.ndarray, " N"]:
    """True for grasps (N,) without measures that can be drawn and whose object is cut."""
    known = np.zeros(len(collection), dtype=bool)
    for key in measured_columns():
        if key in collection.columns:
            known |= collection.columns[key].known
    return ~known & collection.posed & ~np.isin(collection.group_of, list(collection.rough))


def with_measures(
    collection: Collection,
    report: Callable[[float, str], None],
    check: Callable[[], None],
    keep: Callable[[Collection], None] = lambda collection: None,
) -> Collection:
    """Return the collection with measures of all grasps that were unmeasured.

    Args:
        collection: Grasps.
        report: Called with the completed share, 0 to 1, and a description.
        check: Called often; an exception ends the measuring.
        keep: Called with the collection as measured so far, also when measuring ends early.
    """
    todo = unmeasured(collection)
    found: list[Metrics] = []
    numbers: list[np.ndarray] = []
    try:
        for group, rows, some in _batches(collection, todo):
            check()
            report(sum(map(len, numbers)) / todo.sum(), "measuring grasps")
            found.append(metrics_of(group.scene.select(rows)))
            numbers.append(some)
    finally:
        if found:
            columns = _columns(collection, np.concatenate(numbers), Metrics.join(found))
            collection = collection.with_columns(*columns)
            keep(collection)
    return collection


def _batches(
    collection: Collection, todo: Bool[np.ndarray, " N"]
) -> Iterator[tuple[Group, Int[np.ndarray, " some"], Int[np.ndarray, " some"]]]:
    """Yield batches of grasps of one object and scale: their group, their rows in it, their numbers."""
    for at, group in enumerate(collection.problem.groups):
        numbers = np.flatnonzero(todo & (collection.group_of == at))
        for start in range(0, len(numbers), BATCH_SIZE):
            some = numbers[start : start + BATCH_SIZE]
            yield group, collection.member[some], some


def _columns(collection: Collection, numbers: Int[np.ndarray, " some"], found: Metrics) -> list[Column]:
    """The columns that measuring fills, with new values for some grasps."""
    columns = []
    for column in numeric_columns():
        if column.key in measured_columns():
            before = collection.columns.get(column.key)
            values = np.full(len(collection), np.nan) if before is None else before.values.copy()
            values[numbers] = found.values[measured_columns()[column.key]]
            columns.append(column.with_values(values))
    return columns
