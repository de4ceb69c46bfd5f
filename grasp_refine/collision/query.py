"""Witness queries: the closest or deepest point pair of each body pair, for a batch of poses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from grasp_refine.collision.certified_distance import Tolerances
from grasp_refine.collision.engine import Engine, chosen
from grasp_refine.collision.python_search import PythonSearch
from grasp_refine.collision.search import Search
from grasp_refine.core.arguments import as_numbers, check_kind, describe_value
from grasp_refine.core.errors import CollisionError, GraspRefineError
from grasp_refine.core.profiling import count_queries, stage
from grasp_refine.core.short_repr import spread, tallied
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece


class QueryStatus(IntEnum):
    """Result of a query of a body pair."""

    SEPARATED = 0
    """The bodies are separated; the witness points are the closest ones."""
    PENETRATING = 1
    """The bodies touch or overlap; the witness points are the deepest ones."""
    FAR = 2
    """Not queried: the bodies are at least the cutoff apart; `distance` is that bound, there are no points."""
    FAILED = 3
    """The narrow phase found no usable answer at any tolerance."""
    NOT_FINITE = 4
    """A pose is NaN or infinite."""


_PENETRATING = int(QueryStatus.PENETRATING)
"""The status as a number: a member of an enumeration takes a microsecond to look up."""


@dataclass(frozen=True, eq=False)
class Witness:
    """Witness points of a batch of body pairs; NumPy arrays or torch tensors, shapes (batch, pair, ...).

    Where `valid` is false, the points and the normal are zero and have no meaning.
    """

    point_a: Any
    """Closest or deepest point on body a (batch, pair, 3), world frame, metres."""
    point_b: Any
    """Closest or deepest point on body b (batch, pair, 3), world frame, metres."""
    normal: Any
    """Unit normal (batch, pair, 3) from body a to body b, world frame."""
    distance: Any
    """Signed distance n . (x_b - x_a) (batch, pair) in metres; negative in penetration."""
    status: Any
    """A `QueryStatus` for each pair (batch, pair)."""
    winner: Any
    """Closest piece pair (batch, pair), an index into the table of the pairs; -1 without points."""
    num_queries: np.ndarray
    """Number of narrow-phase queries of each pair (batch, pair)."""

    def __repr__(self) -> str:
        known = tallied(QueryStatus(int(status)).name.lower().replace("_", " ") for status in self.status.reshape(-1))
        distance = np.asarray(self.detached().distance)[np.asarray(self.valid)]
        return f"Witness(batch, pair = {list(self.distance.shape)}: {known}; distance {spread(distance)} m)"

    @property
    def valid(self) -> Any:
        """Mask (batch, pair) of the pairs that have witness points."""
        return self.status <= _PENETRATING

    def pairs(self, index: Any) -> "Witness":
        """Return the columns `index` of the pair axis."""
        return self._map(lambda value: value[:, index])

    def detached(self) -> "Witness":
        """Return the witness as NumPy arrays in double precision, without a graph."""

        def array(value: Any) -> np.ndarray:
            return value if isinstance(value, np.ndarray) else value.detach().double().cpu().numpy()

        return self._map(array)

    def rows(self, index: Any) -> "Witness":
        """Return the rows `index` of the batch axis."""
        return self._map(lambda value: value[index])

    def reshape(self, *shape: int) -> "Witness":
        """Return the witness with other leading dimensions."""
        lead = self.distance.ndim
        return self._map(lambda value: value.reshape(*shape, *value.shape[lead:]))

    def _map(self, function: Callable[[Any], Any]) -> "Witness":
        return Witness(*map(function, vars(self).values()))


@dataclass(frozen=True, eq=False)
class Pairs:
    """P body pairs (a[p], b[p]) that are queried together; built once, then only poses change."""

    a: tuple[Body, ...]
    """First body of each pair; normals point away from it."""
    b: tuple[Body, ...]
    """Second body of each pair."""
    tolerances: Tolerances = Tolerances()
    """Tolerances of the narrow phase."""
    engine: Engine = "auto"
    """Engine of the queries (see `collision.engine`)."""

    def __repr__(self) -> str:
        names = [f"{a.name} - {b.name}" for a, b in zip(self.a[:3], self.b[:3], strict=True)]
        return f"Pairs({len(self)}: {', '.join(names)}{', ...' if len(self) > 3 else ''})"

    def __post_init__(self) -> None:
        """Check the fields; lists become tuples.

        Raises:
            CollisionError: not bodies, or different numbers of them on the two sides.
        """
        for name in ("a", "b"):
            bodies = getattr(self, name)
            listed = isinstance(bodies, tuple | list)
            wrong = [body for body in bodies if not isinstance(body, Body)] if listed else [bodies]
            if wrong:
                raise CollisionError(
                    f'Pairs: {name} must be a tuple of bodies, such as (load_object("mug").body,), got '
                    f"{describe_value(wrong[0])}"
                )
            object.__setattr__(self, name, tuple(bodies))
        check_kind("Pairs: tolerances", self.tolerances, Tolerances)
        if len(self.a) != len(self.b) or not self.a:
            raise CollisionError(f"pairs need equally many bodies on both sides, got {len(self.a)} and {len(self.b)}")
        chosen(self.engine)

    @staticmethod
    def against(bodies: Sequence[Body], other: Body) -> "Pairs":
        """Return the pairs of each of `bodies` with one `other` body."""
        return Pairs(tuple(bodies), (other,) * len(bodies))

    def __len__(self) -> int:
        return len(self.a)

    def take(self, index: np.ndarray) -> "Pairs":
        """Return the pairs `index`."""
        return Pairs(tuple(self.a[p] for p in index), tuple(self.b[p] for p in index), self.tolerances, self.engine)

    @cached_property
    def piece_pairs(self) -> tuple[list[Piece], list[Piece]]:
        """Pieces of both sides of every piece pair, indexed by `Witness.winner`."""
        both = [pair for a, b in zip(self.a, self.b, strict=True) for pair in product(a.pieces, b.pieces)]
        return [a for a, _ in both], [b for _, b in both]

    @cached_property
    def first_piece_pair(self) -> np.ndarray:
        """Index (P,) of the first piece pair of each body pair; (i, j) follows i K_b + j later."""
        counts = [len(a.pieces) * len(b.pieces) for a, b in zip(self.a, self.b, strict=True)]
        return np.cumsum([0, *counts[:-1]])

    @cached_property
    def derived(self) -> dict[str, Any]:
        """Structures that other modules built from the pairs, by name, so that each is built once."""
        return {}

    @cached_property
    @stage("loading")
    def search(self) -> Search:
        """Search of the engine among the piece pairs."""
        if chosen(self.engine) == "python":
            return PythonSearch(self.a, self.b, self.tolerances)
        from grasp_refine.collision.native_search import NativeSearch

        return NativeSearch(self.a, self.b, self.tolerances)


def query(
    pairs: Pairs,
    T_world_a: np.ndarray,
    T_world_b: np.ndarray,
    *,
    cutoff: np.ndarray | float = np.inf,
    previous: Witness | None = None,
) -> Witness:
    """Return the closest or deepest points of each body pair, the minimum over all its pieces.

    Args:
        pairs: The P body pairs.
        T_world_a: Poses of the first bodies (batch, P, 4, 4).
        T_world_b: Poses of the second bodies (batch, P, 4, 4).
        cutoff: Distance (metres; one number or one per pair) beyond which pairs are not queried; NaN: not at all.
        previous: The answer at nearby poses of the same batch. Its closest pieces are queried first and warm-start
            GJK where they were separated, which changes the work, and the result by rounding only.

    Returns:
        Witness points in world coordinates. Pairs with a pose that is not finite get the status NOT_FINITE.

    Raises:
        CollisionError: poses, cutoffs or the previous answer have another shape or are not numeric. Rigidity of poses
            is not checked.
    """
    # A query of one pair takes ten microseconds: no check here may cost as much.
    if not isinstance(pairs, Pairs):
        check_kind("pairs", pairs, Pairs)
    if previous is not None and not isinstance(previous, Witness):
        check_kind("previous", previous, Witness | None)
    try:
        T_world_a, T_world_b = as_numbers("T_world_a", T_world_a), as_numbers("T_world_b", T_world_b)
        check_poses(len(pairs), T_world_a, T_world_b, previous)
        shape = T_world_a.shape[:2]
        if not isinstance(cutoff, float):
            cutoff = as_numbers("cutoff", cutoff)
            if cutoff.shape not in ((), (1,), shape[1:], shape):
                raise CollisionError(
                    f"cutoff must be one number or one a pair ({len(pairs)},), got {describe_value(cutoff)}"
                )
    except GraspRefineError as error:
        raise CollisionError(str(error)) from None
    return _search(pairs, None, T_world_a, T_world_b, np.full(shape, cutoff, dtype=np.float64), previous)


def check_poses(pairs: int, T_world_a: Any, T_world_b: Any, previous: Witness | None) -> None:
    """Refuse poses that are not (batch, pairs, 4, 4) both, and a previous answer of another batch.

    Raises:
        CollisionError: names the shapes.
    """
    shape = tuple(T_world_a.shape)
    if len(shape) != 4 or shape[1:] != (pairs, 4, 4) or shape != tuple(T_world_b.shape):
        advice = "; add the batch dimension, T[None]" if len(shape) == 3 else ""
        raise CollisionError(
            f"poses must have shape (batch, {pairs}, 4, 4), got {shape} and {tuple(T_world_b.shape)}{advice}"
        )
    if previous is not None and tuple(previous.distance.shape) != shape[:2]:
        raise CollisionError(f"previous is of shape {tuple(previous.distance.shape)}, the poses of {shape[:2]}")


@stage("broad phase")
def query_items(
    pairs: Pairs,
    pair: np.ndarray,
    T_world_a: np.ndarray,
    T_world_b: np.ndarray,
    *,
    cutoff: np.ndarray | float = np.inf,
    previous: Witness | None = None,
) -> Witness:
    """Return the closest or deepest points of items of any shape (...), each a body pair at some poses.

    Args:
        pairs: The P body pairs.
        pair: Body pair (...) of each item.
        T_world_a: Poses of the first bodies (..., 4, 4).
        T_world_b: Poses of the second bodies (..., 4, 4).
        cutoff: Distance (metres; one number or one per item) beyond which items are not queried; NaN: not at all.
        previous: The answer at nearby poses of the same items.
    """
    return _search(pairs, pair, T_world_a, T_world_b, np.full(np.shape(pair), cutoff, dtype=np.float64), previous)


def _search(
    pairs: Pairs,
    pair: np.ndarray | None,
    T_a: np.ndarray,
    T_b: np.ndarray,
    limit: np.ndarray,
    previous: Witness | None,
) -> Witness:
    """Answers of the engine, in the shape of `limit`; without `pair` all pairs, repeated."""
    last = None if previous is None else (previous.winner, previous.point_a, previous.point_b, previous.status)
    T_a, T_b = (np.ascontiguousarray(T, dtype=np.float64) for T in (T_a, T_b))
    found = Witness(*pairs.search.query(pair, T_a, T_b, limit, last))
    count_queries(found.num_queries)
    return found
