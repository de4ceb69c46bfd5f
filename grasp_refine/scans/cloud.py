"""Cloud: points of a file as they are there, before they are cleaned; and bounds on their number."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.errors import MeshError

MAX_READ_POINTS = 16_000_000
"""Most points of a file."""

MAX_KEPT_POINTS = 1_000_000
"""Most points of a file that are kept; of more, every second, third ... one."""

AXES, NORMAL_AXES = ("x", "y", "z"), (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))
"""Names of coordinates, and of normals, in PLY files and in PCD files."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of a file."""

    points: Float[np.ndarray, "P 3"]
    """Points, in the unit and frame of the file; NaN: none."""
    normals: Float[np.ndarray, "P 3"] | None = None
    """Normals of any length."""
    origins: Float[np.ndarray, "V 3"] | None = None
    """Optical centres of the sensors."""
    view: Int[np.ndarray, " P"] | None = None
    """Index of the sensor of each point."""
    count: int = 0
    """Number of points of the file, where not all are kept."""


def check_point_count(count: int, name: object) -> None:
    """Refuse too many points.

    Raises:
        MeshError: names the number and the limit.
    """
    if count > MAX_READ_POINTS:
        raise MeshError(
            f"{name}: has {count} points; at most {MAX_READ_POINTS} are read: thin them first, 10000 are enough"
        )


def every(count: int) -> int:
    """Return the step from one kept point to the next of `count` points."""
    return -(-count // MAX_KEPT_POINTS)


def cloud_of_columns(columns: Mapping[str, np.ndarray], count: int, name: object, **more: np.ndarray) -> Cloud:
    """Return the cloud of named columns (P,).

    Raises:
        MeshError: a coordinate is missing.
    """
    missing = [axis for axis in AXES if axis not in columns]
    if missing:
        raise MeshError(f"{name}: its points have no {', '.join(missing)}, but {', '.join(columns) or 'nothing'}")

    def stacked(axes: Sequence[str]) -> np.ndarray:
        with np.errstate(invalid="ignore"):  # NaN of many kinds
            return np.stack([columns[axis].astype(np.float64) for axis in axes], axis=-1)

    normals = [axes for axes in NORMAL_AXES if all(axis in columns for axis in axes)]
    return Cloud(stacked(AXES), stacked(normals[0]) if normals else None, count=count, **more)


def text_columns(lines: object, count: int, columns: Sequence[int], name: object) -> np.ndarray:
    """Return some columns (P, C) of at most `count` lines of numbers of an open text file.

    Raises:
        MeshError: a line has too few numbers, or others.
    """
    if not columns:
        return np.zeros((count, 0))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of an empty file
            values = np.loadtxt(lines, usecols=columns, max_rows=count, ndmin=2, dtype=np.float64)  # type: ignore[call-overload]
    except (ValueError, IndexError, UnicodeDecodeError) as error:
        raise MeshError(f"{name}: its points cannot be read ({' '.join(str(error).split())[:160]})") from None
    return values.reshape(-1, len(columns))
