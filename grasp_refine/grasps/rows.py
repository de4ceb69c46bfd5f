"""Rows of grasp sets: those of one object, by their numbers, or by a mask."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int, Shaped

from grasp_refine.core.arguments import describe_value
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.plurals import count_text

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


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
