"""Protrusion of convex pieces from the mesh that they cover, by branch and bound.

Where pieces cover more than the mesh, the distance to the mesh is largest somewhere on the surface of a piece. On each
triangle of that surface it is bounded from both sides. From below, by the distance of the corners. From above, because
the distance to one triangle of the mesh is a convex function, so nowhere on the piece's triangle larger than at the
worst of its corners; and the distance to the mesh is nowhere larger than that to any one triangle of the mesh.
Triangles that can still hold the maximum are subdivided in four.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from grasp_refine.geometry.nearest_triangle import Triangles, distance_to_triangles
from grasp_refine.geometry.pieces import Piece

MAX_OVERESTIMATE = 0.05
"""Largest overestimate of the result, as a fraction of the true value."""

_COPLANARITY_RATIO = 1e-6
"""Largest distance between planes that count as one, as a fraction of the size of their faces."""

MAX_TRIANGLES = 100_000
"""Triangles after which the search ends with the bound reached; takes some seconds."""

_MAX_PLANES = 256
"""Most planes that are compared."""

_QUARTERS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
"""Four parts of a triangle with corners 0, 1, 2 and midpoints 3 (of 0-1), 4 (of 1-2), 5 (of 2-0)."""


def over_cover(pieces: Sequence[Piece], mesh: Triangles, *, least: float) -> float:
    """Protrusion of the union of polytope `pieces` from `mesh`, in metres; 0 where it is at most `least`.

    That is the largest distance to the mesh from a point on the surface of a piece that is in no other piece,
    overestimated by at most `MAX_OVERESTIMATE`; by more, but never underestimated, if `MAX_TRIANGLES` do not suffice.
    Points closer to another piece than `least` count as inside it.
    """
    found = [_uncovered(piece, mesh) for piece in pieces]
    left, owner = np.concatenate(found), np.repeat(np.arange(len(pieces)), [len(faces) for faces in found])
    best = bound = 0.0
    looked_at = 0
    while len(left):
        hidden, exposed = _hidden(left, owner, pieces, least)
        left, owner, exposed = left[~hidden], owner[~hidden], exposed[~hidden]
        points = np.concatenate([left, left.mean(axis=1, keepdims=True)], axis=1)
        distance, near = (answer.reshape(-1, 4) for answer in mesh.nearest(points.reshape(-1, 3)))
        best = max(best, float(np.where(exposed, distance[:, :3], 0.0).max(initial=0.0)))
        worst = distance_to_triangles(left[:, None], mesh.corners[near][:, :, None]).max(axis=2).min(axis=1)
        looked_at += len(left)
        unsure = (worst > (best * (1 + MAX_OVERESTIMATE) if best > least else least)) & (looked_at < MAX_TRIANGLES)
        bound = max(bound, float(worst[~unsure].max(initial=0.0)))
        left, owner = left[unsure], np.repeat(owner[unsure], 4)
        corners = np.concatenate([left, (left + np.roll(left, -1, axis=1)) / 2], axis=1)
        left = corners[:, _QUARTERS].reshape(-1, 3, 3)
    return bound if bound > least else 0.0


def _uncovered(piece: Piece, mesh: Triangles) -> Float[np.ndarray, "F 3 3"]:
    """Corners of the faces of a piece, without those that evidently are faces of the mesh.

    Faces in one plane are, if the triangles of the mesh in that plane have the same area; checked for the largest ones.
    """
    corners = piece.vertices[piece.faces]
    known = set(map(bytes, _sorted(mesh.corners)))
    new = np.array([bytes(key) not in known for key in _sorted(corners)], dtype=bool)
    size = np.ptp(piece.vertices, axis=0).max()
    offsets = np.einsum("fx,fx->f", piece.normals, corners[:, 0])
    keys = np.round(np.concatenate([piece.normals, offsets[:, None] / size], axis=1), 6)
    _, first, of_plane = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    area = np.bincount(of_plane, piece.areas)
    large = np.argsort(-np.where(np.bincount(of_plane, new) > 0, area, 0.0), kind="stable")[:_MAX_PLANES]
    vertices, face = np.unique(mesh.corners.reshape(-1, 3), axis=0, return_inverse=True)
    flush = np.abs(vertices @ piece.normals[first[large]].T - offsets[first[large]]) < _COPLANARITY_RATIO * size
    there = mesh.areas @ flush[face.reshape(-1, 3)].all(axis=1)
    covered = np.zeros(len(area), dtype=bool)
    covered[large] = np.abs(there - area[large]) < _COPLANARITY_RATIO * area[large]
    return corners[new & ~covered[of_plane]]


def _sorted(triangles: Float[np.ndarray, "N 3 3"]) -> Float[np.ndarray, "N 3 3"]:
    """Corners of each triangle in an order that depends on the corners only."""
    order = np.lexsort(np.moveaxis(triangles, 2, 0), axis=1)
    return np.take_along_axis(triangles, order[..., None], axis=1)


def _hidden(
    triangles: Float[np.ndarray, "N 3 3"], owner: Int[np.ndarray, " N"], pieces: Sequence[Piece], flush: float
) -> tuple[Bool[np.ndarray, " N"], Bool[np.ndarray, "N 3"]]:
    """Masks of the triangles that lie in another piece than their owner, and of their corners that lie in none."""
    hidden, exposed = np.zeros(len(triangles), dtype=bool), np.ones((len(triangles), 3), dtype=bool)
    for index, piece in enumerate(pieces if len(pieces) > 1 else ()):
        of = np.flatnonzero((owner != index) & ~hidden)
        normals, offsets = piece.planes
        inside = (triangles[of] @ normals.T - offsets).max(axis=2, initial=-np.inf) < flush
        hidden[of] = inside.all(axis=1)
        exposed[of] &= ~inside
    return hidden, exposed
