"""Outward normals at points of bodies: of a face, or inside the normal cone of an edge or a vertex."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from grasp_refine.geometry.pieces import Piece

ON_FEATURE_RATIO = 1e-6
"""Distance within which a point is on a face, an edge or a vertex, as a fraction of the piece's size."""


def pseudonormals(pieces: Sequence[Piece], points: np.ndarray) -> np.ndarray:
    """Return unit outward normals (N, 3) at points (N, 3) on the surface of a body, in its frame.

    They are the sums of the normals of the faces at a point, each weighted by the angle that its face takes up there
    (Baerentzen and Aanaes 2005). Unlike sums weighted by area they do not depend on how faces are cut into triangles.
    On a convex piece they are positive combinations of all these normals, so they lie inside the normal cone.

    Args:
        pieces: Pieces of the body; the one that a point is nearest to, or deepest in, counts.
        points: Points in metres.
    """
    found = [_of_piece(piece, points) for piece in pieces]
    if len(found) == 1:
        return found[0][0]
    nearest = np.stack([away for _, away in found]).argmin(axis=0)
    return np.stack([normal for normal, _ in found])[nearest, np.arange(len(points))]


def _of_piece(piece: Piece, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return normals (N, 3) of a piece at points (N, 3), and the signed distances (N,) of the points.

    Rounded edges and vertices of a polytope have the normal of the face that is nearest.
    """
    if len(piece.vertices) <= 2:
        start, axis = piece.vertices[0], piece.vertices[-1] - piece.vertices[0]
        along = np.clip((points - start) @ axis / max(axis @ axis, np.finfo(np.float64).tiny), 0.0, 1.0)
        outward = points - start - along[:, None] * axis
        away = np.sqrt((outward**2).sum(axis=1))
        return outward / np.maximum(away, np.finfo(np.float64).tiny)[:, None], away - piece.radius
    normals, offsets = piece.planes
    corners = piece.vertices[piece.faces[piece.normals.any(axis=1)]]
    above = points @ normals.T - offsets
    highest = above.max(axis=1)
    tolerance = ON_FEATURE_RATIO * piece.diagonal
    point, face = np.nonzero(above >= highest[:, None] - tolerance)
    total = np.zeros_like(points)
    below = points[point] - above[point, face, None] * normals[face]
    angles = _angles(below, corners[face], normals[face], tolerance)
    np.add.at(total, point, angles[:, None] * normals[face])
    length = np.sqrt((total**2).sum(axis=1, keepdims=True))
    on_a_face = length > ON_FEATURE_RATIO
    nearest = normals[above.argmax(axis=1)]
    return np.where(on_a_face, total / np.where(on_a_face, length, 1.0), nearest), highest - piece.radius


def _angles(points: np.ndarray, corners: np.ndarray, normals: np.ndarray, tolerance: float) -> np.ndarray:
    """Return angles (M,) that triangles take up about points in their planes, in radians.

    2 pi inside, pi on an edge, the interior angle at a corner, and 0 outside.

    Args:
        points: Points (M, 3) in metres.
        corners: Corners (M, 3, 3) of a triangle for each, in metres.
        normals: Unit normals (M, 3) of the triangles.
        tolerance: Distance in metres within which a point is on an edge or at a corner.
    """
    u = corners - points[:, None]
    v = np.roll(u, -1, axis=1)
    across = (np.cross(u, v) * normals[:, None]).sum(axis=2)
    along = (u * v).sum(axis=2)
    edge = np.sqrt(((v - u) ** 2).sum(axis=2))
    # Seen from a point on it, an edge has no angle: rounding would make it half a turn to either side.
    near = tolerance * (edge + tolerance)
    return np.where((np.abs(across) <= near) & (along <= near), 0.0, np.arctan2(across, along)).sum(axis=1)
