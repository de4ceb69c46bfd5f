"""Dataclasses of arrays with one row per member of a batch: taking rows, joining, and choosing between two."""

from dataclasses import fields, is_dataclass
from typing import TypeVar

import numpy as np

Batch = TypeVar("Batch")
"""An array with a leading batch dimension, a dataclass of such (and of such dataclasses), or None.

A dataclass may hold tuples too, of what is the same for all members."""


def take(rows: Batch, index: np.ndarray) -> Batch:
    """The rows `index`, which are numbers or a mask."""
    if rows is None or isinstance(rows, tuple):
        return rows
    if is_dataclass(rows):
        return type(rows)(*(take(getattr(rows, field.name), index) for field in fields(rows)))
    return rows[index]


def join(first: Batch, *others: Batch) -> Batch:
    """All rows of the first, then all of the others, in that order."""
    if first is None or isinstance(first, tuple):
        return first
    if is_dataclass(first):
        names = [field.name for field in fields(first)]
        return type(first)(*(join(*(getattr(part, name) for part in (first, *others))) for name in names))
    return np.concatenate([first, *others])


def choose(mask: np.ndarray, first: Batch, second: Batch) -> Batch:
    """The rows of the first where the mask (batch,) holds, else those of the second."""
    if first is None:
        return None
    if is_dataclass(first):
        names = [field.name for field in fields(first)]
        return type(first)(*(choose(mask, getattr(first, name), getattr(second, name)) for name in names))
    return np.where(mask.reshape(-1, *(1,) * (first.ndim - 1)), first, second)
