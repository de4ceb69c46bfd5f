"""Shapes of coal for convex pieces, built alike for both engines, so that both query the same bodies.

coal's tolerances are lengths, and suit bodies about as large as the unit of length: on a plate of 0.1 mm, EPA
at 1e-8 m is off by the thickness. So each pair of pieces is queried in a unit of its own.

coal counts the neighbours of a hull's vertex in one byte. A hull with too many is triangulated again with few edges
at each vertex.
"""

import math
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np

from grasp_refine.geometry.pieces import Piece

_MAX_NEIGHBOURS = 255

Shape = TypeVar("Shape", covariant=True)
"""Shape with its placement in the frame of its body."""


@runtime_checkable
class Factory(Protocol[Shape]):
    """Factory of shapes."""

    def sphere(self, radius: float, center: np.ndarray) -> Shape:
        """Return a sphere about `center` (3,)."""

    def capsule(self, radius: float, length: float, frame: np.ndarray, center: np.ndarray) -> Shape:
        """Return a capsule along the third column of `frame` (3, 3), with its middle at `center` (3,)."""

    def hull(self, vertices: np.ndarray, radius: float) -> Shape:
        """Return the hull of `vertices` (V, 3), computed by Qhull, inflated by `radius`."""

    def polytope(self, vertices: np.ndarray, faces: np.ndarray, radius: float) -> Shape:
        """Return the polytope with these triangles (F, 3), inflated by `radius`."""


def unit_of(a: Piece, b: Piece) -> float:
    """Unit of length for queries of two pieces, in metres: the larger piece is 1/8 to 1 of it long.

    A power of 8, so that changing units is exact, and pieces of one body mostly share a unit.
    """
    _, exponent = math.frexp(max(a.diagonal, b.diagonal))
    return math.ldexp(1.0, 3 * math.ceil(exponent / 3))


def build_shape(piece: Piece, make: Factory[Shape]) -> Shape:
    """Build the shape of a piece; a hull takes some milliseconds."""
    vertices = np.ascontiguousarray(piece.vertices, dtype=np.float64)
    if len(vertices) == 1:
        return make.sphere(piece.radius, vertices[0])
    if len(vertices) == 2:
        axis = vertices[1] - vertices[0]
        length = float(np.linalg.norm(axis))
        return make.capsule(piece.radius, length, _frame(axis / length), vertices.mean(axis=0))
    edges = np.unique(
        np.sort(np.concatenate([piece.faces[:, [0, 1]], piece.faces[:, [1, 2]], piece.faces[:, [2, 0]]])),
        axis=0,
    )
    if np.bincount(edges.ravel()).max() <= _MAX_NEIGHBOURS // 2:
        return make.hull(vertices, piece.radius)
    return make.polytope(vertices, few_neighbours(piece), piece.radius)


def _frame(z: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) whose third column is the unit vector z."""
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def few_neighbours(piece: Piece) -> np.ndarray:
    """Triangles (F, 3) of the same hull, with flat many-sided faces as zigzag strips, not fans."""
    corners = piece.vertices[piece.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = np.einsum("fi,fi->f", normals, corners[:, 0])
    size = np.ptp(piece.vertices, axis=0).max()
    planes = np.round(np.concatenate([normals, offsets[:, None] / size], axis=1), 7)
    triangles: list[tuple[int, int, int]] = []
    for members in _groups(planes):
        ids = np.unique(piece.faces[members])
        normal = normals[members[0]]
        centered = piece.vertices[ids] - piece.vertices[ids].mean(axis=0)
        frame = _frame(normal)
        ring = ids[np.argsort(np.arctan2(centered @ frame[:, 1], centered @ frame[:, 0]))].tolist()
        low, high, lower = 0, len(ring) - 1, True
        while high - low > 1:
            if lower:
                triangles.append((ring[low], ring[low + 1], ring[high]))
                low += 1
            else:
                triangles.append((ring[low], ring[high - 1], ring[high]))
                high -= 1
            lower = not lower
    return np.array(triangles)


def _groups(rows: np.ndarray) -> list[np.ndarray]:
    """Groups of indices of equal rows."""
    _, group = np.unique(rows, axis=0, return_inverse=True)
    order = np.argsort(group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)
