"""Patches in which links touch an object: all of both surfaces that is as good as in contact, for regions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.se3 import inverse, tangents, transform_points
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece
from grasp_refine.objects.region import ContactRegions
from grasp_refine.scene.contact_selection import contact_misses

PATCH_M = 3e-4
"""Distance in metres within which the surface of a link is in contact with the object."""

SPACING_M = 2e-3
"""Largest distance in metres of points along the edges of a surface."""

DISC_M, RING_M, NUM_ANGLES = 6e-3, 2.5e-4, 24
"""Radius in metres of a disc about a witness point, in the plane of contact, where surfaces are round; the distance of
its rings, and the number of points of each."""

FLAT = 0.9999
"""Cosine of the angle between two faces from which on the edge between them is none."""


@dataclass(frozen=True, eq=False)
class PatchMisses:
    """Distances of contact patches of N grasps and L links from where hands may touch."""

    miss: Float[np.ndarray, "N L"]
    """Largest distance (N, L) of a point of the patch, metres; 0 for links that do not touch, and inside."""
    point: Float[np.ndarray, "N L 3"]
    """The point (N, L, 3), object frame, metres; the witness point on the object where the patch is inside."""


def patch_misses(
    regions: ContactRegions,
    bodies: Sequence[Body],
    obj: Body,
    T_object_link: Float[np.ndarray, "N L 4 4"],
    witness: Witness,
) -> PatchMisses:
    """Return how far patches of contact are outside of regions.

    A link within `PATCH_M` touches with a patch: the points of either surface that are within as much of the other
    body. They are sampled: the candidates of both bodies, points along their edges, `SPACING_M` apart, and a disc
    about the witness points, near enough to both. A link within `CONTACT_DISTANCE_M` touches at its witness point.

    Args:
        regions: Regions in which they should touch.
        bodies: Geometry of the L links.
        obj: Geometry of the object.
        T_object_link: Poses (N, L, 4, 4) of the links in the object's frame.
        witness: Witness points (N, L) of links and object, object frame.
    """
    miss, point = contact_misses(regions, witness), np.array(witness.point_b)
    touches = witness.valid & (witness.distance <= PATCH_M)
    if not touches.any():
        return PatchMisses(miss, point)
    of_object, rings, of_link = (
        _surface(obj),
        _rings(),
        {k: _surface(bodies[k]) for k in np.flatnonzero(touches.any(axis=0)).tolist()},
    )
    for row, link in np.argwhere(touches).tolist():
        T, middle = T_object_link[row, link], 0.5 * (witness.point_a[row, link] + witness.point_b[row, link])
        disc = middle + rings @ tangents(witness.normal[row, link]).T
        own, theirs = transform_points(T, of_link[link]), np.concatenate([of_object, disc])
        theirs = theirs[_near(bodies[link], transform_points(inverse(T), theirs))]
        patch = np.concatenate([own, theirs])
        patch = patch[_near(obj, patch)]
        if len(patch):
            away = regions.miss(patch)
            worst = int(away.argmax())
            if away[worst] > miss[row, link]:
                miss[row, link], point[row, link] = away[worst], patch[worst]
    return PatchMisses(miss, point)


def _rings() -> Float[np.ndarray, "P 2"]:
    """Return points (P, 2) of a disc, in its plane, without its centre."""
    radius, angle = np.arange(RING_M, DISC_M, RING_M), 2.0 * np.pi * np.arange(NUM_ANGLES) / NUM_ANGLES
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.concatenate([r * circle for r in radius])


def _surface(body: Body) -> Float[np.ndarray, "P 3"]:
    """Return points (P, 3) of the surface of a body: its candidates, and along the edges of its pieces."""
    edges = [_edge_points(piece) for piece in body.pieces if len(piece.faces) and piece.radius == 0.0]
    return np.concatenate([body.candidates.points, *edges])


def _edge_points(piece: Piece) -> Float[np.ndarray, "P 3"]:
    """Return points (P, 3) along the edges of a polytope, its vertices among them."""
    sides = np.concatenate([piece.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    face = np.tile(np.arange(len(piece.faces)), 3)
    order = np.lexsort(np.sort(sides, axis=1).T)
    # Each edge is that of two faces, which follow each other.
    first, second = order[::2], order[1::2]
    sharp = (piece.normals[face[first]] * piece.normals[face[second]]).sum(axis=1) < FLAT
    start, end = (piece.vertices[sides[first[sharp], side]] for side in (0, 1))
    parts = np.ceil(np.linalg.norm(end - start, axis=1) / SPACING_M).astype(int)
    edge = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(edge)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[edge]
    return np.concatenate([piece.vertices, start[edge] + share[:, None] * (end - start)[edge]])


def _near(body: Body, points: Float[np.ndarray, "P 3"]) -> Bool[np.ndarray, " P"]:
    """Return a mask (P,) of points, in the frame of a body, that are within `PATCH_M` of it, or inside."""
    near = np.zeros(len(points), dtype=bool)
    for piece in body.pieces:
        low, high = piece.bounds
        at = np.flatnonzero(((points >= low - PATCH_M) & (points <= high + PATCH_M)).all(axis=1) & ~near)
        near[at] = _height(piece, points[at]) <= PATCH_M
    return near


def _height(piece: Piece, points: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, " P"]:
    """Return the heights (P,) of points above a convex piece: distances, above edges of a polytope a little less."""
    if len(piece.faces):
        normals, offsets = piece.planes
        return (points @ normals.T - offsets).max(axis=1, initial=-np.inf) - piece.radius
    a, b = piece.vertices[0], piece.vertices[-1]
    along = b - a
    share = np.clip((points - a) @ along / max(float(along @ along), 1e-300), 0.0, 1.0)
    return np.linalg.norm(points - a - share[:, None] * along, axis=1) - piece.radius
