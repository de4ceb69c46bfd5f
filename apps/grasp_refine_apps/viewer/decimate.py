"""Decimation of meshes for display, also of open, disconnected or folded ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import trimesh

CELL_GROWTH = 1.25
"""Factor from one size of cells to the next."""


def decimate(mesh: trimesh.Trimesh, max_faces: int) -> trimesh.Trimesh:
    """Return a mesh of at most `max_faces` triangles; the input if it has no more.

    All vertices in one cell of a grid are merged at their mean (Rossignac and Borrel 1993, "Multi-resolution 3D
    approximations"), so that no vertex moves by more than the diagonal of a cell; the cells are about as small as
    `max_faces` allows. Duplicate and degenerate triangles are dropped.
    """
    import trimesh

    if len(mesh.faces) <= max_faces:
        return mesh
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    faces = np.asarray(mesh.faces)
    low = vertices.min(axis=0)
    # A surface of area A has about A / size^2 cells, and two triangles in each.
    size = np.sqrt(mesh.area / max_faces)
    while True:
        place = np.floor((vertices - low) / size).astype(np.int64)
        _, cell, count = np.unique(
            np.ravel_multi_index(place.T, place.max(axis=0) + 1), return_inverse=True, return_counts=True
        )
        joined = cell[faces]
        a, b, c = joined.T
        joined = joined[(a != b) & (b != c) & (c != a)]
        first = np.unique(np.sort(joined, axis=1), axis=0, return_index=True)[1]
        if len(first) <= max_faces:
            break
        size *= CELL_GROWTH
    means = np.stack([np.bincount(cell, vertices[:, axis]) for axis in range(3)], axis=1) / count[:, None]
    return trimesh.Trimesh(means, joined[np.sort(first)], process=False)
