"""The broad phase: signed lower bounds that tell which piece pairs can be the closest of a body pair.

For convex sets inside balls (c, r) and for every unit direction u the signed distance d (negative: minus the
penetration depth) obeys

    d >= |c_b - c_a| - r_a - r_b            (translating along c_b - c_a separates the balls), and
    d >= min_b u . y - max_a u . x          (d is the largest such gap over all u),

apart and in penetration alike. So a piece pair whose bound is not below the distance of another can never win.
The first bound costs one square root; the second is taken with oriented boxes along seven directions, only for
the pairs that the first one leaves.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.geometry.pieces import Piece


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounding balls and oriented boxes of K convex pieces, in the frame of their body."""

    center: np.ndarray
    """Centres (K, 3) of balls and boxes, in metres."""
    radius: np.ndarray
    """Radii (K,) of the balls."""
    axes: np.ndarray
    """Unit axes of the boxes (K, 3, 3), one a row."""
    half: np.ndarray
    """Half side lengths of the boxes (K, 3)."""

    def take(self, index: np.ndarray | tuple[np.ndarray, ...]) -> "Bounds":
        """The bounds of the pieces `index`, in any shape."""
        return Bounds(self.center[index], self.radius[index], self.axes[index], self.half[index])


def bounds_of(pieces: Sequence[Piece]) -> Bounds:
    """Bounding balls and boxes of convex pieces; boxes are aligned with the pieces' principal axes."""
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
    return Bounds(np.array(centers), np.array(radii), np.array(axes), np.array(halves))


def ball_bound(a: Bounds, b: Bounds, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Lower bounds (..., K) of the signed distance from the balls.

    Args:
        a: Pieces of body a (..., K).
        b: Pieces of body b (..., K), in their own frame.
        R: Rotation (..., 3, 3) of body b in the frame of body a.
        t: Its origin (..., 3).
    """
    offset = b.center @ np.swapaxes(R, -1, -2) + t[..., None, :] - a.center
    return np.sqrt(np.einsum("...i,...i->...", offset, offset)) - a.radius - b.radius


def box_bound(a: Bounds, b: Bounds, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Lower bounds (M,) of the signed distance of M piece pairs: the largest gap of their oriented boxes.

    Directions tried: the three axes of either box and the line between the centres. Arguments as above.
    """
    axes_b = b.axes @ np.swapaxes(R, -1, -2)
    offset = np.einsum("mij,mj->mi", R, b.center) + t - a.center
    cosines = np.abs(a.axes @ np.swapaxes(axes_b, -1, -2))
    offset_a = np.abs(np.einsum("mik,mk->mi", a.axes, offset))
    offset_b = np.abs(np.einsum("mjk,mk->mj", axes_b, offset))
    along_a = offset_a - a.half - np.einsum("mij,mj->mi", cosines, b.half)
    along_b = offset_b - b.half - np.einsum("mij,mi->mj", cosines, a.half)
    length = np.sqrt(np.einsum("mi,mi->m", offset, offset))
    reach = np.einsum("mi,mi->m", offset_a, a.half) + np.einsum("mi,mi->m", offset_b, b.half)
    # Boxes with one centre have no such line.
    along_line = np.where(length > 0, length - reach / np.maximum(length, np.finfo(np.float64).tiny), -np.inf)
    return np.maximum(np.maximum(along_a.max(axis=-1), along_b.max(axis=-1)), along_line)
