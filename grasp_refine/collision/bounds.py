"""Spheres, boxes and support functions of convex pieces, by which the compiled search rules out piece pairs.

For convex sets inside spheres (c, r) and for every unit direction u the signed distance d (negative: minus the
penetration depth) obeys

    d >= |c_b - c_a| - r_a - r_b            (translating along c_b - c_a separates the spheres), and
    d >= min_b u . y - max_a u . x          (d is the largest such gap over all u),

separated and in penetration alike. So a piece pair whose bound is not below the distance of another is never the
closest. `native/search.h` takes the second bound along the seven directions of two oriented boxes, and along the normal
of an answer by tabulated support functions.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.geometry.pieces import Piece

CELLS = 16
"""Cells along an edge of the cube: h is too large by at most 4 % of a piece's diameter, 0.2 % on average."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounding spheres and oriented boxes of K convex pieces, in the frame of their body."""

    center: np.ndarray
    """Centres (K, 3) of spheres and boxes, in metres."""
    radius: np.ndarray
    """Radii (K,) of the spheres, in metres."""
    axes: np.ndarray
    """Unit axes of the boxes (K, 3, 3), one a row."""
    half: np.ndarray
    """Half side lengths of the boxes (K, 3), in metres."""


def bounds_of(pieces: Sequence[Piece]) -> Bounds:
    """Return bounding spheres and boxes of convex pieces; boxes are aligned with the pieces' principal axes."""
    return Bounds(*map(np.array, zip(*map(_bounds_of, pieces), strict=True)))


def _bounds_of(piece: Piece) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """Centre (3,), radius, axes (3, 3) and half side lengths (3,) of a piece, found once."""
    if "bounds" not in piece.derived:
        centered = piece.vertices - piece.vertices.mean(axis=0)
        axes = np.linalg.eigh(centered.T @ centered)[1].T
        along = piece.vertices @ axes.T
        low, high = along.min(axis=0), along.max(axis=0)
        center = (low + high) / 2 @ axes
        radius = np.linalg.norm(piece.vertices - center, axis=1).max() + piece.radius
        piece.derived["bounds"] = center, radius, axes, (high - low) / 2 + piece.radius
    return piece.derived["bounds"]


def support_table(bodies: Sequence[Sequence[Piece]]) -> np.ndarray:
    """Tabulate support functions h(u) = max u . x in metres of the pieces of B bodies, at most K each: (B, D, K).

    The D directions are the corners of a square grid on each side of the cube [-1, 1]^3, not normalised; entries are 0
    where a body has fewer pieces. A support function is convex and positively homogeneous. So for
    u = w_1 u_1 + ... + w_4 u_4 with weights w_k >= 0

        h(u) <= w_1 h(u_1) + ... + w_4 h(u_4),

    with equality where one vertex of the piece is extreme in all four directions. A direction is scaled onto the cube,
    where it is the bilinear combination of the corners of its cell. The cost of a look-up does not depend on the number
    of vertices.
    """
    # Only the compiled search uses the table, which takes millions of products.
    from grasp_refine.collision import _native  # type: ignore[attr-defined]  # compiled

    directions = np.ascontiguousarray(_corners().T)
    lengths = np.linalg.norm(directions, axis=0)
    table = np.zeros((len(bodies), len(lengths), max(map(len, bodies))))
    for b, pieces in enumerate(bodies):
        for k, piece in enumerate(pieces):
            if "support" not in piece.derived:
                reach = np.empty(len(lengths))
                _native.support(np.ascontiguousarray(piece.vertices, dtype=np.float64), directions, reach)
                piece.derived["support"] = reach + piece.radius * lengths
            table[b, :, k] = piece.derived["support"]
    return table


def _corners() -> np.ndarray:
    """Directions (D, 3) to the corners of all cells, side by side: +x, -x, +y, -y, +z, -z."""
    steps = np.linspace(-1.0, 1.0, CELLS + 1)
    corners = np.empty((3, 2, CELLS + 1, CELLS + 1, 3))
    for side in range(3):
        corners[side, 0, ..., side], corners[side, 1, ..., side] = 1.0, -1.0
        corners[side, ..., side - 2], corners[side, ..., side - 1] = steps[:, None], steps
    return corners.reshape(-1, 3)
