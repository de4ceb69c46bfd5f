"""Tabulated upper bounds of the support functions of convex pieces.

A support function h(u) = max u . x is convex and positively homogeneous. So for u = w_1 u_1 + ... + w_4 u_4 with
weights w_k >= 0

    h(u) <= w_1 h(u_1) + ... + w_4 h(u_4),

with equality where one vertex of the piece is extreme in all four directions. The table holds h on a square
grid on each side of the cube [-1, 1]^3. A direction is scaled onto the cube, where it is the bilinear combination of
the corners of its cell. The cost of a look-up does not depend on the number of vertices.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.geometry.pieces import Piece

CELLS = 16
"""Cells along an edge of the cube: h is too large by at most 4 % of a piece's diameter, 0.2 % on average."""

_BLOCK_VERTICES = 128
"""Vertices that are processed together."""


@dataclass(frozen=True, eq=False)
class Supports:
    """Tabulated support functions of the pieces of B bodies, at most K each, in the frames of their bodies."""

    table: np.ndarray
    """Values of h in metres at the D corners of all cells (B, D, K); 0 where a body has fewer pieces."""

    @staticmethod
    def of(bodies: Sequence[Sequence[Piece]]) -> "Supports":
        """Tabulate the pieces of each body."""
        directions = _corners()
        lengths = np.linalg.norm(directions, axis=1)
        table = np.zeros((len(bodies), len(directions), max(map(len, bodies))))
        for b, pieces in enumerate(bodies):
            for k, piece in enumerate(pieces):
                if "support" not in piece.derived:
                    piece.derived["support"] = _support(piece.vertices, directions) + piece.radius * lengths
                table[b, :, k] = piece.derived["support"]
        return Supports(table)

    def along(self, body: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Upper bounds (M, K) of max u . x over each piece of the bodies (M,), for nonzero directions u (M, 3)."""
        rows = np.arange(len(u))
        side = np.abs(u).argmax(axis=1)
        length = u[rows, side]
        scale = np.abs(length)
        # Intersection of u with the cube, in cells; columns as in `_corners`.
        x, y = (u[rows, side - 2] / scale + 1.0) * (CELLS / 2), (u[rows, side - 1] / scale + 1.0) * (CELLS / 2)
        i, j = (np.minimum(place.astype(np.int64), CELLS - 1) for place in (x, y))
        x, y = x - i, y - j
        weights = np.array([(1.0 - x) * (1.0 - y), (1.0 - x) * y, x * (1.0 - y), x * y]) * scale
        first = ((2 * side + (length < 0.0)) * (CELLS + 1) + i) * (CELLS + 1) + j
        cell = first[:, None] + np.array([0, 1, CELLS + 1, CELLS + 2])
        return (weights.T[:, None] @ self.table[body[:, None], cell])[:, 0]


def _support(vertices: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Largest u . x over the vertices (V, 3), for directions (D, 3); in blocks of vertices that stay in the cache."""
    reach = np.full(len(directions), -np.inf)
    for start in range(0, len(vertices), _BLOCK_VERTICES):
        reach = np.maximum(reach, (vertices[start : start + _BLOCK_VERTICES] @ directions.T).max(axis=0))
    return reach


def _corners() -> np.ndarray:
    """Directions (D, 3) to the corners of all cells, side by side: +x, -x, +y, -y, +z, -z."""
    steps = np.linspace(-1.0, 1.0, CELLS + 1)
    corners = np.empty((3, 2, CELLS + 1, CELLS + 1, 3))
    for side in range(3):
        corners[side, 0, ..., side], corners[side, 1, ..., side] = 1.0, -1.0
        corners[side, ..., side - 2], corners[side, ..., side - 1] = steps[:, None], steps
    return corners.reshape(-1, 3)
