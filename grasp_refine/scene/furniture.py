"""Bodies of scenes that are made of boxes: tables, bins, walls and shelves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from grasp_refine.geometry.pieces import Piece, box


@dataclass(frozen=True)
class Furniture:
    """A kind of body that is made of boxes."""

    sizes: Mapping[str, float | tuple[float, ...]]
    """Keys of its lengths in metres, with their defaults."""
    pieces: Callable[[Mapping[str, Any]], tuple[Piece, ...]]
    """Function of all lengths that returns its pieces, in its frame."""


def _box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Piece:
    """Return the box between two corners."""
    corners = np.array([low, high])
    T = np.eye(4)
    T[:3, 3] = corners.mean(axis=0)
    return box(corners[1] - corners[0], T)


def _table(of: Mapping[str, Any]) -> tuple[Piece, ...]:
    """Return a plate whose upper side is z = 0."""
    x, y = of["size"]
    return (_box((-x / 2, -y / 2, -of["thickness"]), (x / 2, y / 2, 0.0)),)


def _bin(of: Mapping[str, Any]) -> tuple[Piece, ...]:
    """Return a floor, whose upper side is z = 0, and four walls around the size, which is that inside."""
    (x, y, z), t = np.asarray(of["size"]) / [2, 2, 1], of["thickness"]
    return (
        _box((-x - t, -y - t, -t), (x + t, y + t, 0.0)),
        _box((-x - t, -y - t, 0.0), (-x, y + t, z)),
        _box((x, -y - t, 0.0), (x + t, y + t, z)),
        _box((-x, -y - t, 0.0), (x, -y, z)),
        _box((-x, y, 0.0), (x, y + t, z)),
    )


def _wall(of: Mapping[str, Any]) -> tuple[Piece, ...]:
    """Return a wall that stands on z = 0 along x, its front at y = 0 facing -y."""
    x, z = of["size"]
    return (_box((-x / 2, 0.0, 0.0), (x / 2, of["thickness"], z)),)


def _shelf(of: Mapping[str, Any]) -> tuple[Piece, ...]:
    """Return boards below, whose upper side is z = 0, and above, two sides and a back, open towards -y; size inside."""
    (x, y, z), t = np.asarray(of["size"]) / [2, 2, 1], of["thickness"]
    return (
        _box((-x - t, -y, -t), (x + t, y + t, 0.0)),
        _box((-x - t, -y, z), (x + t, y + t, z + t)),
        _box((-x - t, -y, 0.0), (-x, y + t, z)),
        _box((x, -y, 0.0), (x + t, y + t, z)),
        _box((-x, y, 0.0), (x, y + t, z)),
    )


FURNITURE: Mapping[str, Furniture] = MappingProxyType(
    {
        "table": Furniture({"size": (1.0, 1.0), "thickness": 0.04}, _table),
        "bin": Furniture({"size": (0.3, 0.2, 0.12), "thickness": 0.005}, _bin),
        "wall": Furniture({"size": (1.0, 0.5), "thickness": 0.02}, _wall),
        "shelf": Furniture({"size": (0.5, 0.3, 0.35), "thickness": 0.02}, _shelf),
    }
)
"""Key in scene files -> kind of body."""
