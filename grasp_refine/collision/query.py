"""Witness queries: the closest or deepest point pair of each body pair, for a batch of poses."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np

from grasp_refine.collision.broadphase import Bounds, ball_bound, bounds_of, box_bound
from grasp_refine.collision.narrowphase import Closest, NarrowPhase, Tolerances
from grasp_refine.errors import CollisionError
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece


class QueryStatus(IntEnum):
    """What a query found out about a body pair."""

    SEPARATED = 0
    """The bodies are apart; the witness points are the closest ones."""
    PENETRATING = 1
    """The bodies touch or overlap; the witness points are the deepest ones."""
    FAR = 2
    """Not asked: the bodies are at least the cutoff apart; `distance` is that bound, there are no points."""
    FAILED = 3
    """The narrow phase gave no usable answer at any tolerance."""
    NOT_FINITE = 4
    """A pose is NaN or infinite."""


@dataclass(frozen=True, eq=False)
class Witness:
    """Witness points of a batch of body pairs; NumPy arrays or torch tensors, shapes (batch, pair, ...).

    Where `valid` is false the points and the normal are zero and mean nothing.
    """

    point_a: Any
    """Closest or deepest point on body a (batch, pair, 3), world frame, metres."""
    point_b: Any
    """The same on body b."""
    normal: Any
    """Unit normal (batch, pair, 3) from body a to body b, world frame."""
    distance: Any
    """Signed distance n . (x_b - x_a) (batch, pair) in metres; negative when penetrating."""
    status: Any
    """A `QueryStatus` for each pair (batch, pair)."""
    winner: Any
    """The piece pair that is closest (batch, pair), an index into the table of the pairs; -1 without points."""
    asked: np.ndarray
    """Number of narrow-phase queries that each pair took (batch, pair)."""

    @property
    def valid(self) -> Any:
        """Mask (batch, pair): the pair has witness points."""
        return self.status <= QueryStatus.PENETRATING

    def pairs(self, index: Any) -> "Witness":
        """The columns `index` of the pair axis."""
        return Witness(*(getattr(self, field.name)[:, index] for field in fields(self)))

    def detached(self) -> "Witness":
        """The same as NumPy arrays in double precision, without a graph."""

        def array(value: Any) -> np.ndarray:
            return value if isinstance(value, np.ndarray) else value.detach().double().cpu().numpy()

        return Witness(*(array(getattr(self, field.name)) for field in fields(self)))

    def rows(self, index: Any) -> "Witness":
        """The rows `index` of the batch axis."""
        return Witness(*(getattr(self, field.name)[index] for field in fields(self)))


@dataclass(frozen=True, eq=False)
class Pairs:
    """P body pairs (a[p], b[p]) that are asked together; built once, then only poses change."""

    a: tuple[Body, ...]
    """First body of each pair; normals point away from it."""
    b: tuple[Body, ...]
    """Second body of each pair."""
    tolerances: Tolerances = Tolerances()
    """Of the narrow phase."""

    def __post_init__(self) -> None:
        if len(self.a) != len(self.b) or not self.a:
            raise CollisionError(f"pairs need equally many bodies on both sides, got {len(self.a)} and {len(self.b)}")

    @staticmethod
    def against(bodies: Sequence[Body], other: Body) -> "Pairs":
        """Every one of `bodies` against one `other` body."""
        return Pairs(tuple(bodies), (other,) * len(bodies))

    def __len__(self) -> int:
        return len(self.a)

    @cached_property
    def _table(self) -> "_PieceTable":
        return _PieceTable.build(self)

    def take(self, index: np.ndarray) -> "Pairs":
        """Some of the pairs."""
        return Pairs(tuple(self.a[p] for p in index), tuple(self.b[p] for p in index), self.tolerances)

    @property
    def piece_pairs(self) -> tuple[list[Piece], list[Piece]]:
        """The pieces of both sides of every piece pair, which `Witness.winner` indexes."""
        return self._table.pieces_a, self._table.pieces_b

    @property
    def first_piece_pair(self) -> np.ndarray:
        """Index (P,) of the first piece pair of each body pair."""
        return self._table.id[:, 0]

    @cached_property
    def narrow_phase(self) -> NarrowPhase:
        """The narrow phase over all piece pairs of all body pairs."""
        table = self._table
        return NarrowPhase(table.pieces_a, table.pieces_b, self.tolerances)


@dataclass(frozen=True, eq=False)
class _PieceTable:
    """All piece pairs, padded to the largest number K of any body pair."""

    pieces_a: list[Piece]
    pieces_b: list[Piece]
    id: np.ndarray
    """Index into pieces_a and pieces_b (P, K); -1 pads."""
    bounds_a: Bounds
    bounds_b: Bounds

    @staticmethod
    def build(pairs: Pairs) -> "_PieceTable":
        bounds = {id(body): bounds_of(body.pieces) for body in (*pairs.a, *pairs.b)}
        width = max(len(a.pieces) * len(b.pieces) for a, b in zip(pairs.a, pairs.b, strict=True))
        ids = np.full((len(pairs), width), -1)
        pieces_a, pieces_b, taken_a, taken_b = [], [], [], []
        for p, (a, b) in enumerate(zip(pairs.a, pairs.b, strict=True)):
            i, j = (grid.ravel() for grid in np.meshgrid(range(len(a.pieces)), range(len(b.pieces)), indexing="ij"))
            ids[p, : len(i)] = len(pieces_a) + np.arange(len(i))
            pieces_a += [a.pieces[k] for k in i]
            pieces_b += [b.pieces[k] for k in j]
            pad = np.zeros(width - len(i), dtype=int)
            taken_a.append(bounds[id(a)].take(np.concatenate([i, pad])))
            taken_b.append(bounds[id(b)].take(np.concatenate([j, pad])))
        return _PieceTable(pieces_a, pieces_b, ids, _stack(taken_a), _stack(taken_b))


def query(
    pairs: Pairs,
    T_world_a: np.ndarray,
    T_world_b: np.ndarray,
    *,
    cutoff: np.ndarray | float = np.inf,
    previous: Witness | None = None,
) -> Witness:
    """The closest or deepest points of each body pair, the minimum over all its pieces.

    Args:
        pairs: The P body pairs.
        T_world_a: Poses of the first bodies (batch, P, 4, 4).
        T_world_b: Poses of the second bodies (batch, P, 4, 4).
        cutoff: Pairs surely farther apart than this (metres; one number or one a pair) are not asked.
        previous: The answer at nearby poses of the same batch. Its closest pieces are asked first and warm-start
            GJK where they were apart, which changes the work, and the result by rounding only.

    Returns:
        Witness points in world coordinates. Pairs with a pose that is not finite get the status NOT_FINITE.
    """
    table = pairs._table
    batch, count = T_world_a.shape[:2]
    T_a, T_b = np.asarray(T_world_a, dtype=np.float64), np.asarray(T_world_b, dtype=np.float64)
    # Rows times R_a: each column of R_b, and the offset of the origins, seen from body a.
    with np.errstate(invalid="ignore", over="ignore"):
        relative = np.concatenate([T_b[..., :3, :3].mT, (T_b - T_a)[..., None, :3, 3]], axis=-2) @ T_a[..., :3, :3]
    finite = np.isfinite(relative).all(axis=(-1, -2))
    if not finite.all():
        relative[~finite] = np.eye(4)[:, :3]
    items = relative.reshape(batch * count, 4, 3)
    R, t = np.ascontiguousarray(items[:, :3].mT), np.ascontiguousarray(items[:, 3])
    limit = np.full((batch, count), cutoff, dtype=np.float64).reshape(-1)
    ids = np.broadcast_to(table.id, (batch, *table.id.shape)).reshape(batch * count, table.id.shape[1])

    if ids.shape[1] == 1 and np.isinf(limit).all():
        # Nothing can be pruned: each body pair is one piece pair, and all of them are wanted.
        bound = np.full(ids.shape, -np.inf)
    else:
        with np.errstate(invalid="ignore", over="ignore"):
            bound = ball_bound(table.bounds_a, table.bounds_b, relative[..., :3, :].mT, relative[..., 3, :])
        bound = bound.reshape(ids.shape)
    bound[(ids < 0) | ~finite.reshape(-1, 1)] = np.inf
    found = _minimum(pairs, R, t, ids, bound, limit, _hint(previous, T_a, ids))
    return _witness(found, T_a, limit, finite)


def _minimum(
    pairs: Pairs,
    R: np.ndarray,
    t: np.ndarray,
    ids: np.ndarray,
    bound: np.ndarray,
    limit: np.ndarray,
    hint: tuple[np.ndarray, np.ndarray, np.ndarray] | None,
) -> Closest:
    """Ask the most promising piece pair of each item, then all that can still beat it, best bound first."""
    table, narrow = pairs._table, pairs.narrow_phase
    rows = np.arange(len(ids))
    column = bound.argmin(axis=1)
    guess = guess_valid = None
    if hint is not None:
        winner_column, guess, guess_valid = hint
        column = np.where(winner_column >= 0, winner_column, column)
    found = narrow.closest(
        R, t, np.arange(len(ids) + 1), ids[rows, column], bound[rows, column], limit, guess, guess_valid
    )
    if ids.shape[1] == 1:
        return found
    best = np.minimum(found.distance, limit)
    bound[rows, column] = np.where(found.asked > 0, np.inf, bound[rows, column])
    item, col = np.nonzero(bound < best[:, None])
    body_pair = item % table.id.shape[0]
    tight = np.maximum(
        bound[item, col],
        box_bound(table.bounds_a.take((body_pair, col)), table.bounds_b.take((body_pair, col)), R[item], t[item]),
    )
    open_ = tight < best[item]
    item, col, tight = item[open_], col[open_], tight[open_]
    order = np.lexsort((tight, item))
    item, col, tight = item[order], col[order], tight[order]
    active, lengths = np.unique(item, return_counts=True)
    starts = np.concatenate([[0], np.cumsum(lengths)])
    more = narrow.closest(R[active], t[active], starts, ids[item, col], tight, best[active])
    better = more.winner >= 0
    index = active[better]
    for name in ("distance", "point", "normal", "winner"):
        getattr(found, name)[index] = getattr(more, name)[better]
    found.asked[active] += more.asked
    found.failed[active] |= more.failed
    return found


def _hint(
    previous: Witness | None, T_a: np.ndarray, ids: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Column of the last winner (-1: none), GJK guess x_a - x_b in the frame of a, and where it may be used."""
    if previous is None:
        return None
    winner = np.asarray(previous.winner).reshape(-1)
    has = winner >= 0
    column = np.where(has, winner - ids[:, 0], -1)
    difference = np.asarray(previous.point_a) - np.asarray(previous.point_b)
    guess = np.einsum("bpji,bpj->bpi", T_a[..., :3, :3], difference).reshape(-1, 3)
    apart = (np.asarray(previous.status).reshape(-1) == QueryStatus.SEPARATED) & np.isfinite(guess).all(axis=1)
    return column, np.ascontiguousarray(guess), apart


def _witness(found: Closest, T_a: np.ndarray, limit: np.ndarray, finite: np.ndarray) -> Witness:
    """World coordinates and a status for each pair."""
    shape = T_a.shape[:2]
    distance = found.distance.reshape(shape)
    status = (distance <= 0).astype(np.int8)  # SEPARATED or PENETRATING
    valid = (found.winner >= 0) & ~found.failed & finite.reshape(-1)
    if not valid.all():
        status[(found.winner < 0).reshape(shape)] = QueryStatus.FAR
        status[found.failed.reshape(shape)] = QueryStatus.FAILED
        status[~finite] = QueryStatus.NOT_FINITE
        T_a = np.where(valid.reshape(*shape, 1, 1), T_a, 0.0)
        # FAR: no piece pair was, or can be, below the cutoff.
        distance = np.where(status == QueryStatus.FAR, limit.reshape(shape), distance)
        distance[status > QueryStatus.FAR] = np.nan
    local = np.stack([found.point.reshape(*shape, 3), found.normal.reshape(*shape, 3)], axis=2)
    world = local @ T_a[..., :3, :3].mT
    point_a, normal = world[:, :, 0] + T_a[..., :3, 3], world[:, :, 1]
    moved = np.where(valid.reshape(shape), distance, 0.0)[..., None] * normal
    winner, asked = found.winner.reshape(shape), found.asked.reshape(shape)
    return Witness(point_a, point_a + moved, normal, distance, status, winner, asked)


def _stack(bounds: list[Bounds]) -> Bounds:
    return Bounds(*(np.stack([getattr(b, name) for b in bounds]) for name in ("center", "radius", "axes", "half")))
