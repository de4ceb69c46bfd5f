"""First mesh point on the ray of a click, and nearest point on a collision surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Integer

from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece
from grasp_refine.geometry.sampling import CLEARANCE, internal

NUM_CHECKED_FIRST = 16
"""Number of the nearest points that are checked before all are."""


@dataclass(frozen=True, eq=False)
class SurfacePoint:
    """A point on a surface."""

    point: Float[np.ndarray, " 3"]
    """Position (3,), metres."""
    normal: Float[np.ndarray, " 3"]
    """Unit normal (3,): outward on a collision surface, towards the eye on a mesh that was hit."""
    distance: float
    """Distance from the start of the ray, or from the query point, metres."""


def hit_mesh(
    origin: Float[np.ndarray, " 3"],
    direction: Float[np.ndarray, " 3"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Integer[np.ndarray, "F 3"],
) -> SurfacePoint | None:
    """Return the first point of a mesh on the ray from `origin` along `direction`, or None; faces are two-sided.

    Möller and Trumbore 1997, "Fast, minimum storage ray/triangle intersection", for all triangles at once. A hit on an
    edge is a hit.
    """
    unit = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
    a, b, c = np.moveaxis(np.asarray(vertices, dtype=np.float64)[faces], 1, 0)
    edge, other, arm = b - a, c - a, origin - a
    across, turned = np.cross(unit, other), np.cross(arm, edge)
    volume = np.einsum("fi,fi->f", edge, across)
    size = np.linalg.norm(edge, axis=1) * np.linalg.norm(other, axis=1)
    facing = np.abs(volume) > 1e-12 * size
    scale = 1.0 / np.where(facing, volume, 1.0)
    u, v = np.einsum("fi,fi->f", arm, across) * scale, turned @ unit * scale
    along = np.einsum("fi,fi->f", other, turned) * scale
    edges = -1e-9
    hits = np.flatnonzero(facing & (u >= edges) & (v >= edges) & (u + v <= 1 - edges) & (along >= 0))
    if not len(hits):
        return None
    first = hits[along[hits].argmin()]
    normal = np.cross(edge[first], other[first])
    normal /= -np.copysign(np.linalg.norm(normal), normal @ unit)
    return SurfacePoint(origin + along[first] * unit, normal, float(along[first]))


def nearest_on_surface(body: Body, point: Float[np.ndarray, " 3"]) -> SurfacePoint:
    """Return the point nearest to `point` on the collision surface of a body, with the outward normal there.

    The visual mesh may differ from the convex pieces that collide; targets lie on these. Surfaces of a piece that lie
    in another one, or on a cut between two, do not count. Spheres and capsules are exact.
    """
    points, normals, owners = _nearest(body, point)
    distance = np.linalg.norm(points - point, axis=1)
    order = np.argsort(distance, kind="stable")
    for some in (order[:NUM_CHECKED_FIRST], order):
        covered = internal(points[some], normals[some], owners[some], body.pieces, CLEARANCE * body.diagonal)
        if not covered.all():
            best = some[covered.argmin()]
            break
    else:
        best = order[0]
    return SurfacePoint(points[best], normals[best], float(distance[best]))


def _nearest(
    body: Body, point: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"], Integer[np.ndarray, " N"]]:
    """Nearest points (N, 3) on all faces of all pieces, outward normals (N, 3), and the numbers of the pieces."""
    corners: list[np.ndarray] = [np.zeros((0, 3, 3))]
    points, normals, owners = [], [np.zeros((0, 3))], [np.zeros(0, dtype=np.int64)]
    # Round pieces come last, so that all faces are queried together.
    for number, piece in sorted(enumerate(body.pieces), key=lambda item: _is_round(item[1])):
        if _is_round(piece):
            nearest, outward = _round(piece, point)
            points.append(nearest)
        else:
            surface = piece if piece.radius == 0 else _polytope(piece)
            solid = surface.normals.any(axis=1)
            corners.append(surface.vertices[surface.faces[solid]])
            outward = surface.normals[solid]
        normals.append(outward)
        owners.append(np.full(len(outward), number))
    points.insert(0, closest_on_triangles(point, np.concatenate(corners)))
    return np.concatenate(points), np.concatenate(normals), np.concatenate(owners)


def _is_round(piece: Piece) -> bool:
    return piece.radius > 0 and len(piece.vertices) <= 2


def _round(piece: Piece, point: Float[np.ndarray, " 3"]) -> tuple[np.ndarray, np.ndarray]:
    """The nearest point (1, 3) on a sphere or capsule, and the normal there."""
    a, b = piece.vertices[0], piece.vertices[-1]
    axis = b - a
    core = a + np.clip((point - a) @ axis / max(axis @ axis, np.finfo(np.float64).tiny), 0.0, 1.0) * axis
    away = point - core
    if not away.any():
        # All directions are equally near: take one across the axis.
        away = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))]) if axis.any() else np.array([0.0, 0.0, 1.0])
    normal = away / np.linalg.norm(away)
    return (core + piece.radius * normal)[None], normal[None]


def _polytope(piece: Piece) -> Piece:
    mesh = piece.mesh()
    return Piece(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def closest_on_triangles(
    point: Float[np.ndarray, " 3"], triangles: Float[np.ndarray, "F 3 3"]
) -> Float[np.ndarray, "F 3"]:
    """The point (F, 3) of each triangle that is nearest to `point`."""
    tiny = np.finfo(np.float64).tiny
    a, b, c = np.moveaxis(triangles, 1, 0)
    normal = np.cross(b - a, c - a)
    size = np.einsum("fi,fi->f", normal, normal)
    nearest, least, above = np.zeros_like(a), np.full(len(a), np.inf), size > 0
    for start, end in ((a, b), (b, c), (c, a)):
        edge, arm = end - start, point - start
        along = np.einsum("fi,fi->f", arm, edge) / np.maximum(np.einsum("fi,fi->f", edge, edge), tiny)
        on_edge = start + np.clip(along, 0.0, 1.0)[:, None] * edge
        off = np.linalg.norm(point - on_edge, axis=1)
        nearest[off < least] = on_edge[off < least]
        least = np.minimum(least, off)
        above &= np.einsum("fi,fi->f", np.cross(normal, edge), arm) > 0
    height = np.einsum("fi,fi->f", point - a, normal) / np.maximum(size, tiny)
    return np.where(above[:, None], point - height[:, None] * normal, nearest)
