"""Piece pairs of body pairs, with lower bounds of their signed distances."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from grasp_refine.collision.broadphase import BoundingSpheres, Bounds, bounds_of, box_bound, sphere_bound
from grasp_refine.collision.supports import Supports
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece


@dataclass(frozen=True, eq=False)
class Side:
    """The bodies on one side of P body pairs, at most K pieces each."""

    bodies: tuple[Body, ...]
    """The B distinct bodies."""
    body: np.ndarray
    """Index (P,) into them."""

    @staticmethod
    def of(bodies: Sequence[Body]) -> "Side":
        """Return the side with these P bodies, some of which may be the same."""
        distinct = {id(body): body for body in bodies}
        place = {key: index for index, key in enumerate(distinct)}
        return Side(tuple(distinct.values()), np.array([place[id(body)] for body in bodies]))

    @cached_property
    def width(self) -> int:
        """K, the largest number of pieces of a body."""
        return max(len(body.pieces) for body in self.bodies)

    def bounds(self, pair: np.ndarray, piece: np.ndarray) -> Bounds:
        """Bounds of the pieces (N,) of the bodies in the pairs (N,)."""
        return self.piece_bounds.take(self.first.take(self.body.take(pair)) + piece)

    def bounding_spheres(self, pair: np.ndarray) -> BoundingSpheres:
        """Spheres of all pieces (M, K) of the bodies in the pairs (M,); radii are -inf where a body has fewer."""
        body = self.body.take(pair)
        return BoundingSpheres(
            self._bounding_spheres.center.take(body, axis=0), self._bounding_spheres.radius.take(body, axis=0)
        )

    @cached_property
    def _bounding_spheres(self) -> BoundingSpheres:
        """Bounding spheres of the pieces of all bodies (B, K)."""
        piece = np.arange(self.width)
        present = piece < np.array([len(body.pieces) for body in self.bodies])[:, None]
        spheres = self.piece_bounds.take(self.first[:-1, None] + np.where(present, piece, 0)).bounding_spheres
        return BoundingSpheres(np.ascontiguousarray(spheres.center), np.where(present, spheres.radius, -np.inf))

    def reach(self, pair: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Upper bounds (M, K) of max u . x over the pieces of the bodies in the pairs (M,), for u (M, 3)."""
        return self.supports.along(self.body.take(pair), u)

    @cached_property
    def first(self) -> np.ndarray:
        """Start of each body's pieces in `piece_bounds`, and the end of the last (B + 1,)."""
        return np.cumsum([0, *(len(body.pieces) for body in self.bodies)])

    @cached_property
    def piece_bounds(self) -> Bounds:
        """Bounds of the pieces of all bodies, body by body."""
        return bounds_of([piece for body in self.bodies for piece in body.pieces])

    @cached_property
    def supports(self) -> Supports:
        """Support functions of the pieces of the bodies (B, ...)."""
        return Supports.of([body.pieces for body in self.bodies])


@dataclass(frozen=True, eq=False)
class PieceTable:
    """All N piece pairs of P body pairs.

    A body pair has a column for each of its piece pairs (i, j), which is i K_b + j; K_a and K_b are the largest
    numbers of pieces on either side, so that where a body has fewer, columns are empty.
    """

    a: Side
    """The first bodies."""
    b: Side
    """The second bodies."""
    pieces_a: list[Piece]
    """First piece of each piece pair (N,)."""
    pieces_b: list[Piece]
    """Second piece of each (N,)."""
    id: np.ndarray
    """Index into both lists (P, K_a K_b); -1 in empty columns."""
    column: np.ndarray
    """The column (N,) of each piece pair."""

    @staticmethod
    def of(bodies_a: Sequence[Body], bodies_b: Sequence[Body]) -> "PieceTable":
        """Return the table of the body pairs (bodies_a[p], bodies_b[p])."""
        a, b = Side.of(bodies_a), Side.of(bodies_b)
        ids = np.full((len(bodies_a), a.width, b.width), -1)
        pieces_a: list[Piece] = []
        pieces_b: list[Piece] = []
        columns = []
        for p, (first, second) in enumerate(zip(bodies_a, bodies_b, strict=True)):
            i, j = np.indices((len(first.pieces), len(second.pieces))).reshape(2, -1)
            ids[p, i, j] = len(pieces_a) + np.arange(len(i))
            columns.append(i * b.width + j)
            pieces_a += [first.pieces[k] for k in i]
            pieces_b += [second.pieces[k] for k in j]
        return PieceTable(a, b, pieces_a, pieces_b, ids.reshape(len(ids), -1), np.concatenate(columns))

    def __len__(self) -> int:
        return len(self.id)

    def sphere_bound(self, pair: np.ndarray, R: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lower bounds (M, K_a K_b) from spheres, infinite in empty columns, and the likeliest columns (M,).

        Args:
            pair: Body pairs (M,).
            R: Rotations (M, 3, 3) of bodies b in the frames of bodies a.
            t: Their origins (M, 3).
        """
        bound, likeliest = sphere_bound(self.a.bounding_spheres(pair), self.b.bounding_spheres(pair), R, t)
        return bound.reshape(-1, self.id.shape[1]), likeliest

    def gap_bound(
        self, item: np.ndarray, column: np.ndarray, pair: np.ndarray, u: np.ndarray, R: np.ndarray, t: np.ndarray
    ) -> np.ndarray:
        """Lower bounds (N,) of the columns (N,) of items (N,): the gaps min u . y - max u . x between the pieces.

        Args:
            item: Index (N,) into the M items below.
            column: Columns (N,) of the body pair of the item.
            pair: Body pairs (M,).
            u: Unit directions (M, 3) in the frames of bodies a.
            R: Rotations (M, 3, 3) of bodies b in these frames.
            t: Their origins (M, 3).
        """
        end_a = self.a.reach(pair, u)
        start_b = (u * t).sum(axis=1)[:, None] - self.b.reach(pair, -(u[:, None] @ R)[:, 0])
        i, j = self._split(column)
        return start_b.take(item * self.b.width + j) - end_a.take(item * self.a.width + i)

    def box_bound(self, pair: np.ndarray, column: np.ndarray, R: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Lower bounds (N,) from the boxes of some columns (N,) of body pairs (N,), at poses (3, 3, N) and (3, N)."""
        i, j = self._split(column)
        return box_bound(self.a.bounds(pair, i), self.b.bounds(pair, j), R, t)

    def _split(self, column: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pieces i and j of columns."""
        i = column // self.b.width
        return i, column - i * self.b.width
