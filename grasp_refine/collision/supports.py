"""How far convex pieces reach along any direction, from a table: never less than they do.

A support function h(u) = max u . x is convex and positively homogeneous. So for u = w_1 u_1 + ... + w_4 u_4 with
weights w_k >= 0,

    h(u) <= w_1 h(u_1) + ... + w_4 h(u_4),

and it is equal where one vertex of the piece is extreme in all four directions. The table holds h at a square grid
on each side of the cube [-1, 1]^3; u is scaled onto the cube, where the four corners of its cell and bilinear
weights give it back. What it costs does not depend on the number of vertices.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.geometry.pieces import Piece

CELLS = 12
"""Cells along an edge of the cube: the reach is too long by at most 0.7 % of the radius of a piece."""


@dataclass(frozen=True, eq=False)
class Supports:
    """Tabulated support functions of K pieces of each of P bodies, about the origin of the body's frame."""

    table: np.ndarray
    """h at the corners of the grid (P, 6 (CELLS + 1)^2, K) in metres, for directions on the cube."""

    @staticmethod
    def of(bodies: Sequence[Sequence[Piece]]) -> "Supports":
        """The table of the pieces of some bodies; 0 where a body has fewer than the others."""
        directions = _grid()
        lengths = np.linalg.norm(directions, axis=1)
        table = np.zeros((len(bodies), len(directions), max(map(len, bodies))))
        for body, pieces in enumerate(bodies):
            for k, piece in enumerate(pieces):
                table[body, :, k] = (piece.vertices @ directions.T).max(axis=0) + piece.radius * lengths
        return Supports(table)

    def along(self, body: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Upper bounds (M, K) of max u . x over each piece of the bodies (M,), for directions u (M, 3)."""
        rows = np.arange(len(u))
        side = np.abs(u).argmax(axis=1)
        length = u[rows, side]
        scale = np.abs(length)
        # Where u meets the cube, in cells.
        place = (np.stack([u[rows, side - 2], u[rows, side - 1]], axis=1) / scale[:, None] + 1.0) * (CELLS / 2)
        cell = np.minimum(place.astype(np.int64), CELLS - 1)
        share = place - cell
        corner = ((2 * side + (length < 0)) * (CELLS + 1) + cell[:, 0]) * (CELLS + 1) + cell[:, 1]
        near, far = (1.0 - share) * scale[:, None], share
        weights = np.stack(
            [near[:, 0] * (1 - far[:, 1]), near[:, 0] * far[:, 1], near[:, 1] * far[:, 0], far[:, 0] * far[:, 1] * scale],
            axis=1,
        )
        corners = corner[:, None] + np.array([0, 1, CELLS + 1, CELLS + 2])
        return (weights[:, None] @ self.table[body[:, None], corners])[:, 0]


def _grid() -> np.ndarray:
    """Directions (6 (CELLS + 1)^2, 3) on the cube: sides +x, -x, +y, -y, +z, -z, each a square grid."""
    steps = np.linspace(-1.0, 1.0, CELLS + 1)
    first, second = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    sides = []
    for side in range(3):
        for sign in (1.0, -1.0):
            points = np.empty((len(first), 3))
            points[:, side], points[:, side - 2], points[:, side - 1] = sign, first, second
            sides.append(points)
    return np.concatenate(sides)
