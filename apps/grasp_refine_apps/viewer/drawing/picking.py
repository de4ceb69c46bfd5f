"""First mesh point on the ray of a click, and nearest point on a collision surface."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float, Integer
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece
from grasp_refine.geometry.sampling import CLEARANCE, internal

NUM_CHECKED_FIRST = 16
"""Number of the nearest points that are checked before all are."""

EDGE_TOLERANCE = 1e-9
"""Barycentric tolerance within which a ray at an edge hits the triangle."""


def hit_mesh(
    origin: Float[np.ndarray, " 3"],
    direction: Float[np.ndarray, " 3"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Integer[np.ndarray, "F 3"],
) -> Float[np.ndarray, " 3"] | None:
    """Return the first point of a mesh on the ray from `origin` along `direction`, or None; faces are two-sided.

    Möller and Trumbore 1997, "Fast, minimum storage ray/triangle intersection", for all triangles at once. A hit on an
    edge is a hit.
    """
    unit = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
    a, b, c = np.moveaxis(np.asarray(vertices, dtype=np.float64)[faces], 1, 0)
    edge, other, arm = b - a, c - a, origin - a
    across, turned = np.cross(unit, other), np.cross(arm, edge)
    volume = np.einsum("fi,fi->f", edge, across)
    facing = np.abs(volume) > 1e-12 * np.linalg.norm(edge, axis=1) * np.linalg.norm(other, axis=1)
    scale = 1.0 / np.where(facing, volume, 1.0)
    u, v = np.einsum("fi,fi->f", arm, across) * scale, turned @ unit * scale
    along = np.einsum("fi,fi->f", other, turned) * scale
    inside = np.minimum(np.minimum(u, v), 1.0 - u - v) >= -EDGE_TOLERANCE
    first = np.where(facing & inside & (along >= 0), along, np.inf).min(initial=np.inf)
    return origin + first * unit if np.isfinite(first) else None


def nearest_on_surface(body: Body, point: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Return the point (3,) nearest to `point` on the collision surface of a body.

    The visual mesh may differ from the convex pieces that collide; targets lie on these. Surfaces of a piece that lie
    in another one, or on a cut between two, do not count. Spheres and capsules are exact.
    """
    nearest = [_nearest_of_piece(piece, point) for piece in body.pieces]
    owners = np.repeat(np.arange(len(nearest)), [len(points) for points, _ in nearest])
    points, normals = (np.concatenate(parts) for parts in zip(*nearest, strict=True))
    order = np.argsort(np.linalg.norm(points - point, axis=1), kind="stable")
    for some in (order[:NUM_CHECKED_FIRST], order):
        covered = internal(points[some], normals[some], owners[some], body.pieces, CLEARANCE * body.diagonal)
        if not covered.all():
            return points[some[covered.argmin()]]
    return points[order[0]]


def _nearest_of_piece(
    piece: Piece, point: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, "F 3"], Float[np.ndarray, "F 3"]]:
    """Nearest points (F, 3) on all faces of a piece, and outward normals (F, 3); one of a sphere or a capsule."""
    import trimesh

    if piece.radius > 0 and len(piece.vertices) <= 2:
        return _nearest_of_capsule(piece, point)
    if piece.radius > 0:
        mesh = piece.mesh()
        piece = Piece(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    solid = piece.normals.any(axis=1)
    triangles = piece.vertices[piece.faces[solid]]
    return trimesh.triangles.closest_point(triangles, np.tile(point, (len(triangles), 1))), piece.normals[solid]


def _nearest_of_capsule(piece: Piece, point: Float[np.ndarray, " 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest point (1, 3) on a sphere or capsule, and the normal there."""
    a, b = piece.vertices[0], piece.vertices[-1]
    axis = b - a
    core = a + np.clip((point - a) @ axis / max(axis @ axis, np.finfo(np.float64).tiny), 0.0, 1.0) * axis
    away = point - core
    if not away.any():
        # All directions are equally near: take one across the axis.
        away = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))]) if axis.any() else np.array([0.0, 0.0, 1.0])
    normal = away / np.linalg.norm(away)
    return (core + piece.radius * normal)[None], normal[None]
