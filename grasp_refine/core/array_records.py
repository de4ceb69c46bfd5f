"""Dataclasses of arrays with one row per batch item: take rows, join, and choose between two."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any, TypeVar

import numpy as np

Batch = TypeVar("Batch")
"""An array with a leading batch dimension, a (nested) dataclass or mapping of such arrays, or None.

A dataclass may also hold texts, and tuples of values, shared by all items."""

Item = TypeVar("Item", bound=Hashable)

Record = TypeVar("Record", bound="ArrayRecord")


class ArrayRecord:
    """Base of dataclasses of arrays with one row per item."""

    def select(self: Record, rows: np.ndarray) -> Record:
        """Return the items `rows`, in that order."""
        return take(self, rows)

    @classmethod
    def join(cls: type[Record], parts: Sequence[Record]) -> Record:
        """Return the items of all parts, in that order."""
        return join(*parts)


def take(rows: Batch, index: np.ndarray | slice) -> Batch:
    """The rows `index`, integers, a mask or a slice."""
    return _map_arrays(lambda array: array[index], rows)


def join(first: Batch, *others: Batch) -> Batch:
    """All rows of the first, then all of the others, in that order."""
    return _map_arrays(lambda *arrays: np.concatenate(arrays), first, *others)


def choose(mask: np.ndarray, first: Batch, second: Batch) -> Batch:
    """Rows of the first where the mask (batch,) is true, else of the second.

    Nothing is copied where all rows come from one of them.
    """
    if mask.all():
        return first
    if not mask.any():
        return second
    return _map_arrays(lambda a, b: np.where(mask.reshape(-1, *(1,) * (a.ndim - 1)), a, b), first, second)


def index_distinct(items: Sequence[Item]) -> tuple[tuple[Item, ...], np.ndarray]:
    """The distinct ones of some objects, in order of appearance, and the index (N,) of each object among them."""
    place = {item: index for index, item in enumerate(dict.fromkeys(items))}
    return tuple(place), np.array([place[item] for item in items], dtype=np.int64)


def _map_arrays(function: Callable[..., Any], first: Any, *others: Any) -> Any:
    """Apply `function` to each array of the first and the others; None, texts and tuples are taken from the first."""
    if first is None or isinstance(first, tuple | str):
        return first
    if isinstance(first, Mapping):
        return {key: _map_arrays(function, *(part[key] for part in (first, *others))) for key in first}
    if isinstance(first, np.ndarray):
        return function(first, *others)
    kind: Any = type(first)
    if (names := _field_names(kind)) is None:
        return function(first, *others)
    return kind(*(_map_arrays(function, *(getattr(part, name) for part in (first, *others))) for name in names))


@cache
def _field_names(kind: type) -> tuple[str, ...] | None:
    """Names of the fields of a dataclass; None: it is none."""
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else None
