"""Surface candidates of a body: seeded samples of its exposed surface, with normals and areas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.core.errors import MeshError
from grasp_refine.core.short_repr import brief
from grasp_refine.geometry.pieces import Piece

CLEARANCE = 1e-4
"""Distance to another piece below which a point is internal, as a fraction of the body's diagonal."""

MAX_DRAWS = 8
"""Most draws of points, each twice as large as the last, before a body counts as having no exposed surface."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Points on a body's exposed surface, in the body frame, in random (seeded) order."""

    points: np.ndarray
    """Positions (N, 3) in metres."""
    normals: np.ndarray
    """Unit outward normals (N, 3); at a vertex the mean of the faces around it, weighted by their angles."""
    areas: np.ndarray
    """Surface area (N,) in square metres that each point represents."""

    __repr__ = brief


def check_drawing(count: int, seed: int) -> None:
    """Refuse a number of candidates below 1, or a seed below 0.

    Raises:
        MeshError: names the value.
    """
    if count < 1:
        raise MeshError(f"the number of surface candidates must be at least 1, got {count}")
    if seed < 0:
        raise MeshError(f"the seed must be at least 0, got {seed}")


def sample(pieces: Sequence[Piece], count: int, seed: int) -> Candidates:
    """Draw exactly `count` candidates of the union of `pieces`; deterministic for a seed.

    Up to `count // 2` are exposed vertices of the polytopes, the rest is uniform by area on the surfaces.
    A point inside another piece, or on a cut that faces another piece, is dropped, so that the internal cuts
    of a decomposition carry none. Where two pieces are flush, the surface is counted to the first; vertices
    there are dropped, because the normal of one piece alone would be wrong for the union.
    The areas sum to the exposed area, estimated from the fraction of the drawn points that was kept.

    Raises:
        MeshError: `count` is below 1, the seed below 0, or (nearly) every point of every piece lies inside another
            piece.
    """
    check_drawing(count, seed)
    rng = np.random.default_rng(seed)
    bounds = np.stack([piece.bounds for piece in pieces])
    clearance = CLEARANCE * float(np.linalg.norm(bounds[:, 1].max(0) - bounds[:, 0].min(0)))

    corners, facing, owners = _vertices(pieces)
    chosen = rng.permutation(np.flatnonzero(~beside(corners, owners, pieces, clearance)))[: count // 2]
    points, normals = [corners[chosen]], [facing[chosen]]

    surfaces = [_Surface.of(piece) for piece in pieces]
    areas = np.array([surface.area for surface in surfaces])
    missing = count - len(chosen)
    drawn = exposed = 0
    for draw in range(MAX_DRAWS):
        # More than needed, so that one draw nearly always suffices and the exposed area is estimated well.
        batch = max(2 * count, 1024) * 2**draw
        ladder = np.append(0.0, areas.cumsum()) / areas.sum()
        shares = np.diff(np.floor(ladder * batch + rng.random()).astype(int))
        drawing = [surface.draw(share, rng) for surface, share in zip(surfaces, shares, strict=True)]
        new_points, new_normals = (np.concatenate(columns) for columns in zip(*drawing, strict=True))
        owners = np.repeat(np.arange(len(pieces)), shares)
        free = np.flatnonzero(~internal(new_points, new_normals, owners, pieces, clearance))
        drawn, exposed = drawn + len(new_points), exposed + len(free)
        taken = rng.permutation(free)[:missing]
        points.append(new_points[taken])
        normals.append(new_normals[taken])
        missing -= len(taken)
        if missing == 0:
            break
    else:
        raise MeshError(
            f"no exposed surface: {exposed} of {drawn} points on {len(pieces)} pieces lie outside the others"
        )
    order = rng.permutation(count)
    area = areas.sum() * exposed / drawn / count
    return Candidates(np.concatenate(points)[order], np.concatenate(normals)[order], np.full(count, area))


@dataclass(frozen=True, eq=False)
class _Surface:
    """Surface of one piece, as in Steiner's formula: offset faces, edges swept by an arc, one sphere."""

    piece: Piece
    ends: np.ndarray
    """Edges (E, 2, 3) with a round part."""
    arcs: np.ndarray
    """Orthonormal start and side directions (E, 2, 3) of each edge's arc."""
    angles: np.ndarray
    """Opening (E,) of each arc, in radians."""
    weights: np.ndarray
    """Areas (F + E + 1,) in square metres of the faces, the edges' round parts, and the sphere."""

    @property
    def area(self) -> float:
        return float(self.weights.sum())

    @classmethod
    def of(cls, piece: Piece) -> _Surface:
        """Surface of `piece`: area = sum(face areas) + radius * sum(length * angle) + 4 pi radius^2."""
        face_areas = np.where(piece.normals.any(axis=1), piece.areas, 0.0)
        ends, arcs, angles = _round_edges(piece) if piece.radius > 0 else _NO_EDGES
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        sphere = 4 * np.pi * piece.radius**2
        weights = np.concatenate([face_areas, piece.radius * lengths * angles, [sphere]])
        return cls(piece, ends, arcs, angles, weights)

    def draw(self, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Draw points (count, 3) uniform by area, with their unit outward normals (count, 3)."""
        ladder = self.weights.cumsum()
        # Evenly spaced with one random offset: each part gets its share to within one point.
        steps = (np.arange(count) + rng.random()) / max(count, 1) * ladder[-1]
        part = np.searchsorted(ladder, steps, side="right").clip(max=np.flatnonzero(self.weights)[-1])
        faces, edges = len(self.piece.faces), len(self.ends)
        on_face, on_edge = part[part < faces], part[(part >= faces) & (part < faces + edges)] - faces
        u, v = rng.random((2, len(on_face), 1))
        u, v = np.where(u + v > 1, (1 - u, 1 - v), (u, v))
        a, b, c = np.moveaxis(self.piece.vertices[self.piece.faces[on_face]], 1, 0)
        face_points, face_normals = a + u * (b - a) + v * (c - a), self.piece.normals[on_face]

        along, turn = rng.random((2, len(on_edge), 1))
        start, stop = np.moveaxis(self.ends[on_edge], 1, 0)
        angle = turn * self.angles[on_edge, None]
        edge_normals = np.cos(angle) * self.arcs[on_edge, 0] + np.sin(angle) * self.arcs[on_edge, 1]

        # The round parts at the vertices form one sphere: each direction goes with its support vertex.
        sphere_normals = rng.standard_normal((count - len(on_face) - len(on_edge), 3))
        sphere_normals /= np.linalg.norm(sphere_normals, axis=1, keepdims=True)
        supports = self.piece.vertices[np.argmax(sphere_normals @ self.piece.vertices.T, axis=1)]

        normals = np.concatenate([face_normals, edge_normals, sphere_normals])
        cores = np.concatenate([face_points, start + along * (stop - start), supports])
        return cores + self.piece.radius * normals, normals


_NO_EDGES = np.zeros((0, 2, 3)), np.zeros((0, 2, 3)), np.zeros(0)


def _round_edges(piece: Piece) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends (E, 2, 3), arc frames (E, 2, 3) and openings (E,) of the edges of a piece with a radius."""
    if len(piece.vertices) == 1:
        return _NO_EDGES
    if len(piece.vertices) == 2:
        axis = piece.vertices[1] - piece.vertices[0]
        first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        second = np.cross(axis, first)
        arc = np.stack([first / np.linalg.norm(first), second / np.linalg.norm(second)])
        return piece.vertices[None], arc[None], np.array([2 * np.pi])
    directed = piece.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    face_of = {(int(a), int(b)): index // 3 for index, (a, b) in enumerate(directed)}
    edges = np.array([(a, b) for a, b in face_of if a < b])
    one = piece.normals[[face_of[int(a), int(b)] for a, b in edges]]
    other = piece.normals[[face_of[int(b), int(a)] for a, b in edges]]
    cosine = np.einsum("ei,ei->e", one, other)
    side = other - cosine[:, None] * one
    sine = np.linalg.norm(side, axis=1)
    side /= np.maximum(sine, np.finfo(float).tiny)[:, None]
    return piece.vertices[edges], np.stack([one, side], axis=1), np.arctan2(sine, cosine)


def _vertices(pieces: Sequence[Piece]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All vertices (V, 3) of the sharp polytopes, their angle-weighted unit normals (V, 3) and owners (V,).

    Angles rather than areas, because they do not depend on the triangulation of a flat face.
    """
    points, normals, owners = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros(0, dtype=int)]
    for owner, piece in enumerate(pieces):
        if piece.radius > 0:
            continue
        corners = piece.vertices[piece.faces]
        forward = np.roll(corners, -1, axis=1) - corners
        backward = np.roll(corners, 1, axis=1) - corners
        sine = np.linalg.norm(np.cross(forward, backward), axis=2)
        angle = np.arctan2(sine, np.einsum("fci,fci->fc", forward, backward))
        total = np.zeros_like(piece.vertices)
        np.add.at(total, piece.faces, angle[:, :, None] * piece.normals[:, None, :])
        points.append(piece.vertices)
        normals.append(total / np.linalg.norm(total, axis=1, keepdims=True))
        owners.append(np.full(len(piece.vertices), owner))
    return np.concatenate(points), np.concatenate(normals), np.concatenate(owners)


def internal(
    points: np.ndarray, normals: np.ndarray, owners: np.ndarray, pieces: Sequence[Piece], clearance: float
) -> np.ndarray:
    """Mask (N,) of the points that are in another piece once moved out by `clearance`, or on an earlier one.

    Exact for spheres and capsules; for polytopes it uses the largest plane distance, which near an edge
    is less than the distance itself and so drops slightly more.
    """
    internal = np.zeros(len(points), dtype=bool)
    for index, piece in enumerate(pieces):
        near = _near(points, owners, piece, index, clearance)
        heading_in = _distance(points[near] + clearance * normals[near], piece) < 0
        flush = (owners[near] > index) & (_distance(points[near], piece) < clearance)
        internal[near] |= heading_in | flush
    return internal


def beside(points: np.ndarray, owners: np.ndarray, pieces: Sequence[Piece], clearance: float) -> np.ndarray:
    """Mask (N,) of the points within `clearance` of any other piece, or inside it."""
    beside = np.zeros(len(points), dtype=bool)
    for index, piece in enumerate(pieces):
        near = _near(points, owners, piece, index, clearance)
        beside[near] |= _distance(points[near], piece) < clearance
    return beside


def _near(points: np.ndarray, owners: np.ndarray, piece: Piece, index: int, clearance: float) -> np.ndarray:
    """Indices of the points of other pieces that lie within about `clearance` of the box around `piece`."""
    lower, upper = piece.bounds
    inside = (points > lower - 2 * clearance).all(1) & (points < upper + 2 * clearance).all(1)
    return np.flatnonzero(inside & (owners != index))


def _distance(points: np.ndarray, piece: Piece) -> np.ndarray:
    """Signed distance (N,) of `points` (N, 3) to the piece; for polytopes the largest plane distance."""
    if len(piece.vertices) > 2:
        normals, offsets = piece.planes
        return (points @ normals.T - offsets).max(1) - piece.radius
    a, b = piece.vertices[0], piece.vertices[-1]
    axis = b - a
    along = np.clip((points - a) @ axis / max(axis @ axis, np.finfo(float).tiny), 0, 1)
    return np.linalg.norm(points - a - along[:, None] * axis, axis=1) - piece.radius
