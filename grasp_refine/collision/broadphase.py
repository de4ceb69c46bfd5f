"""The broad phase: signed lower bounds that select the piece pairs that can be the closest of a body pair.

For convex sets inside spheres (c, r) and for every unit direction u the signed distance d (negative: minus the
penetration depth) obeys

    d >= |c_b - c_a| - r_a - r_b            (translating along c_b - c_a separates the spheres), and
    d >= min_b u . y - max_a u . x          (d is the largest such gap over all u),

separated and in penetration alike. So a piece pair whose bound is not below the distance of another is never the
closest. The first bound is one matrix product for all piece pairs of two bodies; the second uses oriented boxes
along seven directions, for the few pairs that remain (see `search`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from grasp_refine.geometry.pieces import Piece


@dataclass(frozen=True, eq=False)
class BoundingSpheres:
    """Bounding spheres of K pieces of each body, in the frames of the bodies."""

    center: np.ndarray
    """Centres (..., K, 3) in metres."""
    radius: np.ndarray
    """Radii (..., K); -inf leaves a piece out."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounding spheres and oriented boxes of K convex pieces, in the frame of their body; pieces are the last axis."""

    center: np.ndarray
    """Centres (3, K) of spheres and boxes, in metres."""
    radius: np.ndarray
    """Radii (K,) of the spheres, in metres."""
    axes: np.ndarray
    """Unit axes of the boxes (3, 3, K), one a row."""
    half: np.ndarray
    """Half side lengths of the boxes (3, K), in metres."""

    def take(self, index: np.ndarray) -> "Bounds":
        """The bounds of the pieces `index`, in any shape."""
        return Bounds(*(np.take(getattr(self, field.name), index, axis=-1) for field in fields(self)))

    @property
    def bounding_spheres(self) -> BoundingSpheres:
        """The spheres only."""
        return BoundingSpheres(np.moveaxis(self.center, 0, -1), self.radius)


def bounds_of(pieces: Sequence[Piece]) -> Bounds:
    """Return bounding spheres and boxes of convex pieces; boxes are aligned with the pieces' principal axes."""
    centers, radii, axes, halves = [], [], [], []
    for piece in pieces:
        centered = piece.vertices - piece.vertices.mean(axis=0)
        rows = np.linalg.eigh(centered.T @ centered)[1].T
        along = piece.vertices @ rows.T
        low, high = along.min(axis=0), along.max(axis=0)
        center = (low + high) / 2 @ rows
        centers.append(center)
        axes.append(rows)
        halves.append((high - low) / 2 + piece.radius)
        radii.append(np.linalg.norm(piece.vertices - center, axis=1).max() + piece.radius)
    return Bounds(*(np.stack(column, axis=-1) for column in (centers, radii, axes, halves)))


def sphere_bound(a: BoundingSpheres, b: BoundingSpheres, R: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower bounds (..., K_a, K_b) of the signed distance of all piece pairs by their spheres, and the likeliest.

    The likeliest piece pair (...), an index into the K_a K_b pairs, is the closest one with spheres of half the
    size: pieces seldom fill theirs.

    Args:
        a: Pieces of body a (..., K_a).
        b: Pieces of body b (..., K_b), in their own frame.
        R: Rotation (..., 3, 3) of body b in the frame of body a.
        t: Its origin (..., 3).
    """
    x, y = a.center, b.center @ R.mT + t[..., None, :]
    # |y - x|^2 in one product. Rounding, a few ulps of |x|^2 + |y|^2, must not make it longer.
    shorter = 1.0 - 16.0 * np.finfo(np.float64).eps
    x = np.concatenate([-2.0 * x, shorter * (x * x).sum(-1, keepdims=True), np.ones((*x.shape[:-1], 1))], axis=-1)
    y = np.concatenate([y, np.ones((*y.shape[:-1], 1)), shorter * (y * y).sum(-1, keepdims=True)], axis=-1)
    bound = x @ y.mT
    np.sqrt(np.maximum(bound, 0.0, out=bound), out=bound)
    half_radii = 0.5 * (a.radius[..., :, None] + b.radius[..., None, :])
    bound -= half_radii
    likeliest = bound.reshape(*bound.shape[:-2], bound.shape[-2] * bound.shape[-1]).argmin(axis=-1)
    bound -= half_radii
    return bound, likeliest


def box_bound(a: Bounds, b: Bounds, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Lower bounds (N,) of the signed distance of N piece pairs: the largest gap of their oriented boxes.

    Directions: the three axes of either box and the line between the centres.

    Args:
        a: First pieces (N,).
        b: Second pieces (N,), in their own frame.
        R: Rotations (3, 3, N) of bodies b in the frames of bodies a.
        t: Their origins (3, N).
    """
    axes_b = np.einsum("ijn,kjn->kin", R, b.axes)
    offset = np.einsum("ijn,jn->in", R, b.center) + t - a.center
    cosines = np.abs(np.einsum("ijn,kjn->ikn", a.axes, axes_b))
    offset_a = np.abs(np.einsum("ijn,jn->in", a.axes, offset))
    offset_b = np.abs(np.einsum("ijn,jn->in", axes_b, offset))
    along_a = offset_a - a.half - np.einsum("ijn,jn->in", cosines, b.half)
    along_b = offset_b - b.half - np.einsum("ijn,in->jn", cosines, a.half)
    length = np.sqrt((offset * offset).sum(axis=0))
    reach = (offset_a * a.half).sum(axis=0) + (offset_b * b.half).sum(axis=0)
    # Concentric boxes have no such line.
    along_line = np.where(length > 0, length - reach / np.maximum(length, np.finfo(np.float64).tiny), -np.inf)
    return np.maximum(np.maximum(along_a.max(axis=0), along_b.max(axis=0)), along_line)
