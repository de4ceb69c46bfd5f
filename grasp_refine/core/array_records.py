"""Dataclasses of arrays with one row per member of a batch: taking rows, joining, and choosing between two."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np

Batch = TypeVar("Batch")
"""An array with a leading batch dimension, a dataclass of such (and of such dataclasses), or None.

A dataclass may hold tuples too, of what is the same for all members."""


def take(rows: Batch, index: np.ndarray) -> Batch:
    """The rows `index`, which are numbers or a mask."""
    return _each(lambda array: array[index], rows)


def join(first: Batch, *others: Batch) -> Batch:
    """All rows of the first, then all of the others, in that order."""
    return _each(lambda *arrays: np.concatenate(arrays), first, *others)


def choose(mask: np.ndarray, first: Batch, second: Batch) -> Batch:
    """The rows of the first where the mask (batch,) holds, else those of the second."""
    return _each(lambda a, b: np.where(mask.reshape(-1, *(1,) * (a.ndim - 1)), a, b), first, second)


def _each(of: Callable[..., Any], first: Any, *others: Any) -> Any:
    """What `of` makes of each array of the first and the others; None and tuples are as the first has them."""
    if first is None or isinstance(first, tuple):
        return first
    if not is_dataclass(first):
        return of(first, *others)
    kind: Any = type(first)
    names = [field.name for field in fields(first)]
    return kind(*(_each(of, *(getattr(part, name) for part in (first, *others))) for name in names))
