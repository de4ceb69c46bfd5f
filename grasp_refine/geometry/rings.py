"""Rings of a triangle mesh: the vertices within a few edges of each vertex."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from scipy.spatial import KDTree


@dataclass(frozen=True, eq=False)
class Rings:
    """The rings about every vertex of a closed mesh, as a ragged table; built once."""

    points: np.ndarray
    """Vertices (V, 3) in metres."""
    normals: np.ndarray
    """Unit outward normals (V, 3): the mean of the faces around each vertex, weighted by their areas."""
    start: np.ndarray
    """Start of each vertex's row in `members`, and the end of the last (V + 1,)."""
    members: np.ndarray
    """Vertices within the given number of edges, itself included, row by row; each row in random (seeded) order."""

    @staticmethod
    def of(vertices: np.ndarray, faces: np.ndarray, edges: int) -> Rings:
        """The vertices within `edges` edges of each vertex of the mesh `vertices` (V, 3), `faces` (F, 3)."""
        from scipy.sparse import csr_array, eye_array

        count = len(vertices)
        corner = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).T
        step = csr_array((np.ones(corner.shape[1], dtype=bool), tuple(corner)), shape=(count, count))
        step = step + step.T + eye_array(count, dtype=bool, format="csr")
        within = step
        for _ in range(edges - 1):
            within = within @ step
        row = np.repeat(np.arange(count), np.diff(within.indptr))
        # Sorted first: the order of a sparse product is not guaranteed.
        order = np.lexsort((within.indices, row))
        shuffled = order[np.lexsort((np.random.default_rng(0).random(len(row)), row))]
        return Rings(vertices, _vertex_normals(vertices, faces), within.indptr, within.indices[shuffled])

    @cached_property
    def tree(self) -> KDTree:
        """Search tree of the vertices."""
        from scipy.spatial import KDTree

        return KDTree(self.points)


def _vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(vertices)
    np.add.at(total, faces, cross[:, None, :])
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), np.finfo(np.float64).tiny)
