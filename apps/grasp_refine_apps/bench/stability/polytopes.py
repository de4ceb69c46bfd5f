"""Convex polytopes: the hull of a difference, nearest points of triangles, supporting faces, separations."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from grasp_refine.geometry.pieces import Piece

FACE_TOLERANCE = 1e-7
"""Vertices this close to a supporting plane (as a share of the size) may be part of the face that touches."""


def surface(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangles (F, 3, 3), outward normals (F, 3) and offsets (F,) of {y - x}; flat: normals 0, offsets infinite."""
    points = (b - a[:, None]).reshape(-1, 3)
    if max(len(a), len(b)) <= 2:
        corners = points[[0, 0, 0]] if len(points) == 1 else points[[0, 1, 1]]
        triangles = points[[[0, 1, 2], [3, 2, 1]]] if len(points) == 4 else corners[None]
        return triangles, np.zeros((len(triangles), 3)), np.full(len(triangles), np.inf)
    found = ConvexHull(points)
    corners = found.points[found.simplices]
    normals, offsets = found.equations[:, :3], -found.equations[:, 3]
    # No vertex may stand out of a plane that Qhull merged from several.
    highest = (normals @ b.T).max(axis=1) - (normals @ a.T).min(axis=1)
    return corners, normals, np.maximum(offsets, highest)


def on_triangles(p: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the nearest points (M, 3) of triangles (M, 3, 3), which may be needles or points."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = b - a, c - a, p - a
    normal = np.cross(ab, ac)
    area = np.einsum("ij,ij->i", normal, normal)
    longest = np.maximum.reduce([np.einsum("ij,ij->i", edge, edge) for edge in (ab, ac, c - b)])
    solid = area > 1e-24 * longest**2
    safe = np.where(solid, area, 1.0)
    v = np.einsum("ij,ij->i", np.cross(ap, ac), normal) / safe
    w = np.einsum("ij,ij->i", np.cross(ab, ap), normal) / safe
    inside = solid & (v >= 0) & (w >= 0) & (v + w <= 1)
    height = np.einsum("ij,ij->i", ap, normal) / safe
    best = np.where(inside[:, None], p - height[:, None] * normal, np.inf)
    squared = np.where(inside, height**2 * area, np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        along = end - start
        length = np.einsum("ij,ij->i", along, along)
        share = np.einsum("ij,ij->i", p - start, along) / np.where(length > 0, length, 1.0)
        point = start + share.clip(0.0, 1.0)[:, None] * along
        gap = np.einsum("ij,ij->i", point - p, point - p)
        nearer = ~inside & (gap < squared)
        best[nearer], squared[nearer] = point[nearer], gap[nearer]
    return best


def supporting(core: np.ndarray, n: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Vertices of a core (V, 3) that are, or nearly are, farthest along each n (N, 3), and its flatness there.

    Flatness is the largest ratio, over all other vertices, of distance from the farthest one to depth behind it.
    """
    heights = n @ core.T
    behind = heights.max(axis=1, keepdims=True) - heights
    item, vertex = np.nonzero(behind <= FACE_TOLERANCE)
    distances = np.linalg.norm(core[heights.argmax(axis=1), None] - core, axis=2)
    slope = np.where(behind <= FACE_TOLERANCE, 1.0, distances / np.maximum(behind, FACE_TOLERANCE)).max(axis=1)
    return np.split(vertex, np.cumsum(np.bincount(item, minlength=len(n)))[:-1]), slope


def is_point(face: np.ndarray) -> bool:
    """Return True if the vertices (V, 3) of a face nearly coincide."""
    return bool(np.ptp(face, axis=0).max() <= FACE_TOLERANCE)


def crossing(first: np.ndarray, second: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return points x and y of the lines through two edges with y - x = q, and the sine of the angle of the edges."""
    u, v = first[1] - first[0], second[1] - second[0]
    sine = np.linalg.norm(np.cross(u, v)) / (np.linalg.norm(u) * np.linalg.norm(v))
    (s, r), *_ = np.linalg.lstsq(np.stack([-u, v], axis=1), q - (second[0] - first[0]), rcond=None)
    return first[0] + s * u, second[0] + r * v, float(sine)


def separations(a: Piece, b: Piece, R: np.ndarray, t: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Distance (N,) of two pieces along unit vectors n (N, 3): a lower bound of their signed distance.

    Args:
        a: The first piece, in whose frame the rest is.
        b: The second piece.
        R: Rotations (N, 3, 3) of the second piece.
        t: Origins (N, 3) of the second piece.
        n: Unit vectors (N, 3).
    """
    middle = a.vertices.mean(axis=0)
    ahead = (n @ (a.vertices - middle).T).max(axis=1)
    behind = (np.einsum("ni,nij->nj", n, R) @ b.vertices.T).min(axis=1)
    return np.einsum("ni,ni->n", n, t - middle) + behind - ahead - a.radius - b.radius


def outside(piece: Piece, x: np.ndarray) -> np.ndarray:
    """Lower bound (N,) of the distance in metres of points x (N, 3), in its frame, to a piece; at most 0: inside."""
    if len(piece.faces):
        normals, offsets = piece.planes
        return (x @ normals.T - offsets).max(axis=1) - piece.radius
    core = on_triangles(x, np.broadcast_to(piece.vertices[[0, 0, -1]], (len(x), 3, 3)))
    return np.linalg.norm(x - core, axis=1) - piece.radius
