"""Patches of flat faces, compiled: `face_patch` in C++ (see `collision/native/face_patch.h`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# Loads coal's library, which _native needs.
from grasp_refine.collision.native_search import threads_for
from grasp_refine.collision.query import Witness
from grasp_refine.geometry.facets import Facets

from grasp_refine.collision import _native  # type: ignore[attr-defined]  # compiled  # isort: skip

_PATCHES_PER_THREAD = 512
"""Fewest patches for another thread."""


def find_patches(
    tables: tuple[np.ndarray, ...],
    limits: tuple[float, ...],
    link: np.ndarray,
    number: np.ndarray,
    T: np.ndarray,
    witness: Witness,
    found: tuple[np.ndarray, ...],
) -> None:
    """Fill in the patches of contacts (M,).

    Args:
        tables: `tables` of the links, then of the objects.
        limits: Cosine of the largest tilt, distance from planes, least extent, and width of segments.
        link: Index (M,) of each contact's link.
        number: Index (M,) of each contact's object.
        T: Poses (M, 4, 4) of the links.
        witness: Witness points (M,).
        found: Arrays to be filled in.
    """
    threads = threads_for(len(link), _PATCHES_PER_THREAD)
    points = (np.ascontiguousarray(part) for part in (T, witness.point_a, witness.point_b, witness.normal))
    indices = np.ascontiguousarray(link), np.ascontiguousarray(number)
    _native.face_patches(*indices, *points, *tables, *limits, *found, threads)


def tables(bodies: Sequence[Facets]) -> tuple[np.ndarray, ...]:
    """Faces of bodies, one after the other, with the first face of each body."""
    polygons = np.cumsum([0, *(body.first_polygon[-1] for body in bodies)])
    vertices = np.cumsum([0, *(body.first_vertex[-1] for body in bodies)])
    return (
        np.cumsum([0, *(len(body) for body in bodies)]),
        np.concatenate([body.normal for body in bodies]),
        np.concatenate([body.offset for body in bodies]),
        _joined([body.first_polygon for body in bodies], polygons),
        _joined([body.first_vertex for body in bodies], vertices),
        np.concatenate([body.vertices for body in bodies]),
    )


def _joined(firsts: Sequence[np.ndarray], start: np.ndarray) -> np.ndarray:
    parts = [first[:-1] + begin for first, begin in zip(firsts, start[:-1], strict=True)]
    return np.concatenate([*parts, start[-1:]]).astype(np.int64)
