"""Search for the closest piece pair of each body pair: selection and order of the queries.

One piece pair is queried first. Its answer is an upper bound, and along its normal u every other pair is at least
min_b u . y - max_a u . x apart, which rules out nearly all of them at the cost of one number a piece.
Boxes are compared for those that remain; then they are queried, best bound first.
"""

from dataclasses import dataclass

import numpy as np

from grasp_refine.collision.narrowphase import Closest, NarrowPhase
from grasp_refine.collision.table import PieceTable

_BLOCK_BOXES = 1024
"""Boxes that are compared at a time, so that intermediate results stay in the cache."""


@dataclass(frozen=True, eq=False)
class WarmStart:
    """Last answer at nearby poses."""

    column: np.ndarray
    """Column (M,) of the closest piece pair; -1 for none."""
    guess: np.ndarray
    """x_a - x_b (M, 3) in metres, in the frames of bodies a: a warm start for GJK."""
    apart: np.ndarray
    """Mask (M,) of the items whose guess may be used."""


@dataclass(frozen=True, eq=False)
class Remaining:
    """N piece pairs that may still be the closest of their items."""

    item: np.ndarray
    """Item (N,) of each piece pair, ascending."""
    column: np.ndarray
    """Column (N,) in the piece table."""
    bound: np.ndarray
    """Lower bound (N,) of the signed distance, in metres."""

    @staticmethod
    def below(best: np.ndarray, bound: np.ndarray) -> "Remaining":
        """Return all columns with a bound (M, K) below the best distance (M,) of their items."""
        place = np.flatnonzero(bound < best[:, None])
        item = place // bound.shape[1]
        return Remaining(item, place - item * bound.shape[1], bound.take(place))

    def raised(self, bound: np.ndarray, best: np.ndarray) -> "Remaining":
        """Raise the bounds to a second lower bound (N,), and drop pairs not below the best (M,) of their items."""
        higher = np.maximum(self.bound, bound)
        index = np.flatnonzero(higher < best.take(self.item))
        return Remaining(self.item.take(index), self.column.take(index), higher.take(index))

    def ascending(self) -> "Remaining":
        """Sort the piece pairs of each item in ascending order of their bounds."""
        order = np.lexsort((self.bound, self.item))
        return Remaining(self.item.take(order), self.column.take(order), self.bound.take(order))

    def runs(self, items: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the A items that have piece pairs left, and the starts of their rows with the end (A + 1,)."""
        counts = np.bincount(self.item, minlength=items)
        active = np.flatnonzero(counts)
        return active, np.concatenate([[0], np.cumsum(counts[active])])


@dataclass(frozen=True, eq=False)
class Search:
    """M items, each a body pair of a table at some poses."""

    table: PieceTable
    """The piece pairs."""
    narrow_phase: NarrowPhase
    """Narrow phase that answers the queries."""
    pair: np.ndarray
    """The body pairs (M,)."""
    R: np.ndarray
    """Rotations (M, 3, 3) of bodies b in the frames of bodies a."""
    t: np.ndarray
    """Their origins (M, 3), in metres."""
    limit: np.ndarray
    """Signed distance (M,) in metres that an answer has to be below."""

    def minimum(self, bound: np.ndarray, column: np.ndarray, warm: WarmStart | None = None) -> Closest:
        """Return the closest piece pair of each item, none where none is below its limit.

        Args:
            bound: Lower bounds (M, K) of the signed distances of all columns; overwritten.
            column: The columns (M,) to query first.
            warm: The last answer, if any. Where it has a column, that one is queried first.
        """
        found = self._query_first(bound, column, warm)
        if bound.shape[1] > 1:
            self._query_rest(bound, found)
        beyond = found.distance >= self.limit
        if beyond.any():
            found.distance[beyond], found.winner[beyond] = np.inf, -1
            found.point[beyond], found.normal[beyond] = 0.0, 0.0
        return found

    def _query_first(self, bound: np.ndarray, column: np.ndarray, warm: WarmStart | None) -> Closest:
        """Query one column of each item, and set its bound to infinity; none where the bound reaches the limit."""
        items = np.arange(len(bound))
        guess = apart = None
        if warm is not None:
            column = np.where(warm.column >= 0, warm.column, column)
            guess, apart = warm.guess, warm.apart
        first = self._raised_by_boxes(bound[items, column], column)
        found = self.narrow_phase.closest(
            self.R,
            self.t,
            np.arange(len(items) + 1),
            self.table.id[self.pair, column],
            np.where(first < self.limit, first, np.inf),
            # Even beyond the limit, the normal of an answer is useful.
            np.full(len(items), np.inf),
            guess,
            apart,
        )
        bound[items, column] = np.where(found.num_queries > 0, np.inf, first)
        return found

    def _raised_by_boxes(self, first: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Lower bounds (M,) of one column of each item, raised by boxes where that may save the query."""
        left = np.flatnonzero((first < self.limit) & np.isfinite(self.limit))
        if len(left):
            raised = self._box_bound(Remaining(left, column[left], first[left]))
            first[left] = np.maximum(first[left], raised)
        return first

    def _query_rest(self, bound: np.ndarray, found: Closest) -> None:
        """Query all columns that can be closer than the first answers, and update `found` with closer ones."""
        best = np.minimum(found.distance, self.limit)
        left = Remaining.below(best, bound)
        if len(left.item):
            left = left.raised(self._gap_bound(left, found.normal), best)
        if len(left.item):
            left = left.raised(self._box_bound(left), best)
        if not len(left.item):
            return
        left = left.ascending()
        active, starts = left.runs(len(best))
        more = self.narrow_phase.closest(
            self.R[active],
            self.t[active],
            starts,
            self.table.id[self.pair.take(left.item), left.column],
            left.bound,
            best[active],
        )
        better = more.winner >= 0
        index = active[better]
        for name in ("distance", "point", "normal", "winner"):
            getattr(found, name)[index] = getattr(more, name)[better]
        found.num_queries[active] += more.num_queries
        found.failed[active] |= more.failed

    def _gap_bound(self, left: Remaining, normal: np.ndarray) -> np.ndarray:
        """Lower bounds (N,) of the remaining pairs, along the normals (M, 3) of the items."""
        active, starts = left.runs(len(normal))
        u = normal[active]
        # Any unit direction gives a bound: without an answer all are equally good.
        u[~(np.abs((u * u).sum(axis=1) - 1.0) <= 1e-12)] = [1.0, 0.0, 0.0]
        run = np.repeat(np.arange(len(active)), np.diff(starts))
        return self.table.gap_bound(run, left.column, self.pair.take(active), u, self.R[active], self.t[active])

    def _box_bound(self, left: Remaining) -> np.ndarray:
        """Lower bounds (N,) of the remaining pairs, from boxes."""
        R, t = np.ascontiguousarray(np.moveaxis(self.R, 0, -1)), np.ascontiguousarray(self.t.T)
        bound = np.empty(len(left.item))
        for start in range(0, len(bound), _BLOCK_BOXES):
            block = slice(start, start + _BLOCK_BOXES)
            item = left.item[block]
            bound[block] = self.table.box_bound(
                self.pair.take(item), left.column[block], R.take(item, axis=-1), t.take(item, axis=-1)
            )
        return bound
