"""Faces, edges and vertices of convex pieces, with a direction that points away from the piece."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from grasp_refine.geometry.pieces import Piece
from grasp_refine_apps.bench.stability.cases import State

COPLANAR_TOLERANCE = 1e-6
"""Faces whose normals differ by less than this are one face, without an edge between them."""


@dataclass(frozen=True, eq=False)
class Feature:
    """A face, an edge or a vertex of a piece."""

    corners: np.ndarray
    """Corners (1, 2 or 3, 3), metres, of which its points are convex combinations."""
    outward: np.ndarray
    """A unit vector (3,) along which no point of the piece is farther."""
    tangent: np.ndarray
    """A unit vector (3,) perpendicular to it: along the edge, or any."""

    def points(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Draw points (count, 3) on it."""
        return rng.dirichlet(np.ones(len(self.corners)), count) @ self.corners


def face(piece: Piece, rng: np.random.Generator, towards: np.ndarray | None = None) -> Feature:
    """Choose a face of a piece: the one that faces a direction (3,) most, or any, large ones more often."""
    area = np.where(piece.normals.any(axis=1), piece.areas, 0.0)
    k = rng.choice(len(area), p=area / area.sum()) if towards is None else (piece.normals @ towards).argmax()
    corners = piece.vertices[piece.faces[k]]
    return Feature(corners, piece.normals[k], _unit(corners[1] - corners[0]))


def edge(piece: Piece, rng: np.random.Generator, towards: np.ndarray | None = None) -> Feature:
    """Choose an edge between two faces that are not in one plane: the one most towards a direction (3,), or any."""
    loops = np.stack([piece.faces, np.roll(piece.faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    owner = np.repeat(np.arange(len(piece.faces)), 3)
    order = np.lexsort(np.sort(loops, axis=1).T)
    first, second = owner[order[0::2]], owner[order[1::2]]
    normals = piece.normals
    both = normals[first].any(axis=1) & normals[second].any(axis=1)
    sharp = np.flatnonzero(both & (np.linalg.norm(normals[first] - normals[second], axis=1) > COPLANAR_TOLERANCE))
    means = normals[first[sharp]] + normals[second[sharp]]
    k = sharp[rng.integers(len(sharp)) if towards is None else (means @ towards).argmax()]
    corners = piece.vertices[loops[order[2 * k]]]
    tangent = _unit(corners[1] - corners[0])
    outward = _unit(normals[first[k]] + normals[second[k]])
    return Feature(corners, _unit(outward - (outward @ tangent) * tangent), tangent)


def vertex(piece: Piece, rng: np.random.Generator, towards: np.ndarray | None = None) -> Feature:
    """Choose a vertex: the farthest in a direction (3,), which points away from it; or any, with its mean normal."""
    if towards is None:
        v = rng.integers(len(piece.vertices))
        outward = _unit(piece.normals[(piece.faces == v).any(axis=1)].sum(axis=0))
    else:
        v, outward = (piece.vertices @ towards).argmax(), towards
    tangent = _unit(np.cross(np.eye(3)[np.abs(outward).argmin()], outward))
    return Feature(piece.vertices[[v]], outward, tangent)


def extreme(pieces: Sequence[Piece], rng: np.random.Generator) -> tuple[Piece, np.ndarray]:
    """Return the farthest of several pieces in a random direction (3,), and that direction."""
    towards = _unit(rng.normal(size=3))
    return max(pieces, key=lambda piece: (piece.vertices @ towards).max()), towards


FEATURE: Mapping[State, Callable[[Piece, np.random.Generator, np.ndarray | None], Feature]] = MappingProxyType(
    {"face-face": face, "edge-edge": edge, "vertex-vertex": vertex}
)
"""State -> function that finds a feature for it."""


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
