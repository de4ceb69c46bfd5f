"""Rows of grasp sets: of one object, by numbers, by a mask, by conditions, or the best of each object."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from grasp_refine.core.arguments import describe_value
from grasp_refine.core.array_types import Float, Int, Shaped
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.plurals import count_text

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

COMPARISONS: dict[str, Callable[[Any, float], Any]] = {
    ">=": operator.ge, "<=": operator.le, "=": operator.eq, ">": operator.gt, "<": operator.lt,
}  # fmt: skip
"""Comparisons of conditions."""
CONDITION = re.compile(r"\s*([^<>=\s]+)\s*(>=|<=|=|>|<)\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*")
"""Condition on values: their name, a comparison and a number."""
TEXT_CONDITION = re.compile(r"\s*([^<>=\s]+)\s*=\s*(.*\S)\s*")
"""Condition on texts: their name, = and a text."""


def choose_rows(
    objects: Shaped[np.ndarray, " N"], *, object_name: str | None, index: Sequence[int] | None
) -> Int[np.ndarray, " chosen"]:
    """Return the rows (ascending unless `index` orders them) of the grasps of one of the objects (N,).

    `index` counts the grasps of that object: 0 is its first grasp in the file. None takes all of them. Raises
    GraspFileError when the file holds several objects and none is named, when the named one is not among
    them, and when an index is out of range.
    """
    names, counts = np.unique(objects, return_counts=True)
    listing = ", ".join(f"{name} ({count})" for name, count in zip(names, counts, strict=True))
    if object_name is None:
        if len(names) > 1:
            raise GraspFileError(f"the grasps are of {len(names)} objects, choose one by name: {listing}")
        object_name = str(names[0])
    rows = np.flatnonzero(objects == object_name)
    if not len(rows):
        raise GraspFileError(f"no grasp of object '{object_name}'; there are grasps of {listing}")
    if index is None:
        return rows
    outside = [i for i in index if not 0 <= i < len(rows)]
    if outside:
        raise GraspFileError(
            f"grasp index {', '.join(map(str, outside))} is out of range: "
            f"'{object_name}' has {count_text(len(rows), 'grasp')}, 0 to {len(rows) - 1}"
        )
    return rows[np.asarray(index, dtype=int)]


def rows_where(values: Mapping[str, Shaped[np.ndarray, " N"]], condition: str) -> Int[np.ndarray, " chosen"]:
    """Return the rows whose value fulfils a condition such as "success=1", "confidence>=0.5" or "change=kept".

    A grasp without the value, NaN or an empty text, fulfils none.

    Args:
        values: Numbers or texts of all grasps (N,), by name.
        condition: Name, comparison and number; or name, = and text.

    Raises:
        GraspFileError: the condition is none, or the grasps have no such values.
    """
    texts = {name: each for name, each in values.items() if each.dtype.kind == "U"}
    equal = TEXT_CONDITION.fullmatch(condition)
    if equal is not None and equal[1] in texts:
        return np.flatnonzero(texts[equal[1]] == equal[2])
    found = CONDITION.fullmatch(condition)
    if found is None or found[1] in texts:
        raise GraspFileError(
            f"a condition is NAME, one of {', '.join(COMPARISONS)}, and a number, as in success=1, "
            f"or a text, as in change=kept; got '{condition}'"
        )
    name, sign, number = found.groups()
    if name not in values:
        there = ", ".join(values) or "none"
        raise GraspFileError(f"the grasps have no label or measure '{name}'; they have: {there}")
    return np.flatnonzero(COMPARISONS[sign](values[name], float(number)))


def best_rows(
    values: Float[np.ndarray, " N"], objects: Shaped[np.ndarray, " N"], count: int
) -> Int[np.ndarray, " chosen"]:
    """Return the rows (ascending) of the `count` largest values of each object; of equal ones, the first.

    Args:
        values: Values of all grasps (N,); NaN is never chosen.
        objects: Names of their objects (N,).
        count: Most rows of an object.
    """
    ranked = np.argsort(-values, kind="stable")
    ranked = ranked[~np.isnan(values[ranked])]
    return np.sort(np.concatenate([ranked[objects[ranked] == name][:count] for name in np.unique(objects)]))


def row_numbers(indices: ArrayLike, count: int) -> Int[np.ndarray, " chosen"]:
    """Numbers of rows of `count`, from numbers or a mask.

    Raises:
        GraspFileError: neither, or a row out of range.
    """
    rows = np.asarray(indices)
    if rows.dtype == bool and rows.shape == (count,):
        return np.flatnonzero(rows)
    if rows.ndim != 1 or (rows.size and rows.dtype.kind not in "iu"):
        raise GraspFileError(f"rows must be a list of integers or a mask ({count},), got {describe_value(indices)}")
    if rows.size and not -count <= rows.min() <= rows.max() < count:
        raise GraspFileError(f"rows must be below {count}, the number of grasps, got {describe_value(indices)}")
    return rows.astype(int)
