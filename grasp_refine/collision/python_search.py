"""The engine in Python: plain and slow, for machines without the compiled one, which is the norm.

Its distances equal the compiled engine's up to rounding. Where several pieces are equally far, or two faces are
parallel, it may choose other witness points.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from grasp_refine.collision.certified_distance import Answer, PiecePair, Tolerances
from grasp_refine.core.profiling import stage
from grasp_refine.geometry.body import Body

_SEPARATED, _PENETRATING, _FAR, _FAILED, _NOT_FINITE = range(5)
"""Values of `query.QueryStatus`."""


@dataclass
class _Closest:
    """Closest piece pair so far, in the frame of body a."""

    answer: Answer = field(default_factory=lambda: Answer(np.inf, np.zeros(3), np.zeros(3)))
    """Signed distance and witness point in metres, and the normal."""
    column: int = -1
    """The piece pair: i K_b + j for piece i of a and j of b; -1: none."""
    num_queries: int = 0
    """Number of queries."""
    failed: bool = False
    """Whether a query could not be answered, so that the minimum is not certain."""


class PythonSearch:
    """The search among the piece pairs of P body pairs."""

    def __init__(self, a: Sequence[Body], b: Sequence[Body], tolerances: Tolerances) -> None:
        """Prepare the pairs (a[p], b[p])."""
        self._bodies = tuple(zip(a, b, strict=True))
        self._first = np.cumsum([0, *(len(one.pieces) * len(other.pieces) for one, other in self._bodies)])
        self._piece_pair = cache(lambda one, other: PiecePair(one, other, tolerances))

    @stage("narrow phase")
    def query(
        self,
        pair: np.ndarray | None,
        T_a: np.ndarray,
        T_b: np.ndarray,
        limit: np.ndarray,
        previous: tuple[np.ndarray, ...] | None,
    ) -> tuple[np.ndarray, ...]:
        """Return the answers, as `search.Search` says."""
        shape, M = limit.shape, limit.size
        pair = np.arange(M) % len(self._bodies) if pair is None else np.reshape(pair, M)
        limit, T_a, T_b = limit.reshape(M), T_a.reshape(M, 4, 4), T_b.reshape(M, 4, 4)
        points, distance = np.zeros((3, M, 3)), np.full(M, np.nan)
        status, (winner, num_queries) = np.empty(M, np.int8), np.empty((2, M), np.int64)
        last = None if previous is None else [np.reshape(array, (M, *array.shape[len(shape) :])) for array in previous]
        for i, p in enumerate(pair):
            R_a, before = T_a[i, :3, :3], (-1, None)
            if last is not None:
                column, point_a, point_b, code = (array[i] for array in last)
                guess = R_a.T @ (point_a - point_b)
                before = column - self._first[p], guess if code == _SEPARATED and np.isfinite(guess).all() else None
            with np.errstate(invalid="ignore", over="ignore"):
                R, t = R_a.T @ T_b[i, :3, :3], R_a.T @ (T_b[i, :3, 3] - T_a[i, :3, 3])
            finite = np.isfinite(R).all() and np.isfinite(t).all()
            found = self._minimum(p, R, t, limit[i], *before) if finite else _Closest()
            d = found.answer.distance
            winner[i] = found.column + self._first[p] if found.column >= 0 else -1
            num_queries[i] = found.num_queries
            status[i] = (
                _NOT_FINITE if not finite
                else _FAILED if found.failed
                else _FAR if found.column < 0
                else _PENETRATING if d <= 0 else _SEPARATED
            )  # fmt: skip
            if status[i] <= _PENETRATING:
                normal = R_a @ found.answer.normal
                point = R_a @ found.answer.point + T_a[i, :3, 3]
                points[:, i], distance[i] = (point, point + d * normal, normal), d
            elif status[i] == _FAR:
                # No piece pair was, or can be, below the limit.
                distance[i] = limit[i]
        fields = (*points, distance, status, winner, num_queries)
        return tuple(values.reshape(*shape, *values.shape[1:]) for values in fields)

    def _minimum(
        self, pair: int, R: np.ndarray, t: np.ndarray, limit: float, column: int, guess: np.ndarray | None
    ) -> _Closest:
        """Return the closest piece pair of a body pair that is below the limit.

        One piece pair, the last winner or the one with the lowest bound, is queried first. Its answer is an upper
        bound, and along its normal every other pair is at least the gap apart.
        """
        a, b = self._bodies[pair]
        between = (b.centers @ R.T + t)[None] - a.centers[:, None]
        bound = (np.linalg.norm(between, axis=2) - a.radii[:, None] - b.radii).reshape(-1)
        if not 0 <= column < bound.size:
            column, guess = int(bound.argmin()), None
        found, best = _Closest(), limit

        def query(column: int, guess: np.ndarray | None) -> Answer:
            nonlocal best
            i, j = divmod(column, len(b.pieces))
            answer = self._piece_pair(a.pieces[i], b.pieces[j]).distance(R, t, bound[column], guess)
            found.num_queries += 1
            found.failed |= bool(np.isnan(answer.distance))
            if answer.distance < best:
                found.answer, found.column, best = answer, column, answer.distance
            return answer

        if bound[column] < limit:
            answer = query(column, guess)
            if not np.isnan(answer.distance):
                u = answer.normal
                gap = u @ t - _support(b, -(u @ R))[None, :] - _support(a, u)[:, None]
                bound = np.maximum(bound, gap.reshape(-1))
        bound[column] = np.inf
        for column in bound.argsort(kind="stable").tolist():
            if not bound[column] < best:
                break
            query(column, None)
        return found


def _support(body: Body, u: np.ndarray) -> np.ndarray:
    """Largest u . x (K,) over each piece of a body."""
    return np.array([(piece.vertices @ u).max() + piece.radius for piece in body.pieces])
