"""Exact distances from points to a triangle mesh, through a tree of boxes that many points descend together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

LEAF_TRIANGLES = 4
"""Triangles in a leaf."""

_BLOCK_POINTS = 4096
"""Points that descend the tree together, which bounds the memory."""


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles of a mesh, open or closed, prepared for nearest-triangle queries."""

    corners: Float[np.ndarray, "F 3 3"]
    """Corners of each triangle, in metres."""

    @cached_property
    def areas(self) -> Float[np.ndarray, " F"]:
        """Area of each triangle in square metres."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)

    def nearest(self, points: Float[np.ndarray, "N 3"]) -> tuple[Float[np.ndarray, " N"], Int[np.ndarray, " N"]]:
        """Distance (N,) in metres to the nearest triangle, and that triangle (N,)."""
        found = [self._nearest(points[start : start + _BLOCK_POINTS]) for start in range(0, len(points), _BLOCK_POINTS)]
        if not found:
            return np.zeros(0), np.zeros(0, dtype=np.int64)
        distance, triangle = zip(*found, strict=True)
        return np.concatenate(distance), np.concatenate(triangle)

    def _nearest(self, points: Float[np.ndarray, "N 3"]) -> tuple[Float[np.ndarray, " N"], Int[np.ndarray, " N"]]:
        order, levels = self._tree
        # At most the distance to the nearest corner or centre; slightly more, so that rounding drops no triangle.
        limit = self._landmarks.query(points)[0] ** 2 * (1 + 1e-9) + np.finfo(np.float64).tiny
        point: np.ndarray = np.arange(len(points))
        node: np.ndarray = np.zeros(len(points), dtype=np.int64)
        for low, high in levels[1:]:
            point, node = np.repeat(point, 2), (2 * node[:, None] + [0, 1]).ravel()
            at = points[point]
            outside = np.maximum(np.maximum(low[node] - at, at - high[node]), 0.0)
            close = np.einsum("nx,nx->n", outside, outside) <= limit[point]
            point, node = point[close], node[close]
        point, triangle = np.repeat(point, LEAF_TRIANGLES), order[node].ravel()
        distance = distance_to_triangles(points[point], self.corners[triangle])
        by_point = np.lexsort((distance, point))
        first = by_point[np.searchsorted(point[by_point], np.arange(len(points)))]
        return distance[first], triangle[first]

    @cached_property
    def _landmarks(self) -> cKDTree:
        """Corners and centres of all triangles."""
        return cKDTree(np.concatenate([np.unique(self.corners.reshape(-1, 3), axis=0), self.corners.mean(axis=1)]))

    @cached_property
    def _tree(self) -> tuple[Int[np.ndarray, "leaf 4"], list[tuple[np.ndarray, np.ndarray]]]:
        """Triangles of each leaf, and boxes of all nodes of each level, from the root on.

        A full binary tree, split at the median of the longest side; some triangles are in it twice.
        """
        depth = max(0, int(np.ceil(np.log2(len(self.corners) / LEAF_TRIANGLES))))
        order = np.resize(np.arange(len(self.corners)), LEAF_TRIANGLES * 2**depth)
        centers = self.corners.mean(axis=1)
        for level in range(depth):
            order = order.reshape(2**level, -1)
            inside = centers[order]
            axis = np.ptp(inside, axis=1).argmax(axis=1)
            along = np.take_along_axis(inside, axis[:, None, None], axis=2)[..., 0]
            order = np.take_along_axis(order, along.argsort(axis=1, kind="stable"), axis=1)
        order = order.reshape(-1, LEAF_TRIANGLES)
        boxes = [(self.corners[order].min(axis=(1, 2)), self.corners[order].max(axis=(1, 2)))]
        while len(boxes[0][0]) > 1:
            low, high = boxes[0]
            boxes.insert(0, (low.reshape(-1, 2, 3).min(axis=1), high.reshape(-1, 2, 3).max(axis=1)))
        return order, boxes


def distance_to_triangles(
    points: Float[np.ndarray, "*#batch 3"], triangles: Float[np.ndarray, "*#batch 3 3"]
) -> Float[np.ndarray, " ..."]:
    """Distances in metres of points to triangles, pairwise; a triangle may degenerate to a segment or a point."""
    tiny = np.finfo(np.float64).tiny
    a, b, c = triangles[..., 0, :], triangles[..., 1, :], triangles[..., 2, :]
    normal = np.cross(b - a, c - a)
    size = np.einsum("...x,...x->...", normal, normal)
    nearest, above = np.inf, size > 0
    for start, end in ((a, b), (b, c), (c, a)):
        edge, arm = end - start, points - start
        along = np.einsum("...x,...x->...", arm, edge) / np.maximum(np.einsum("...x,...x->...", edge, edge), tiny)
        off = arm - np.clip(along, 0.0, 1.0)[..., None] * edge
        nearest = np.minimum(nearest, np.einsum("...x,...x->...", off, off))
        # Left of the edge, seen against the normal.
        above = above & (np.einsum("...x,...x->...", np.cross(normal, edge), arm) > 0)
    height = np.einsum("...x,...x->...", points - a, normal) ** 2 / np.maximum(size, tiny)
    return np.sqrt(np.where(above, height, nearest))
