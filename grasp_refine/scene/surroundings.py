"""Distances of the links of hands from the bodies around the object: only near pairs are queried.

A body is near a link where their signed distance may be below a reach. Lower bounds of all signed distances are kept
from one evaluation to the next, less the motion of the link, which is exact: a signed distance changes by no more than
a body moves. Where a bound is not above the reach, it is found anew from boxes of the body, then of its pieces; what
these do not rule out is queried, all grasps together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from grasp_refine.collision.culling import bounding_sphere, motion
from grasp_refine.collision.query import Pairs, QueryStatus, Witness, query_items
from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.profiling import count_scene_pairs, stage
from grasp_refine.core.se3 import inverse, transform_points
from grasp_refine.geometry.body import Body
from grasp_refine.scene.environment import Environment

LEAVES_START_M = 0.25
"""Distance in metres by which hands may leave the box around their starts and the object; bodies that are farther are
no part of a refinement. Measures leave none out."""

GRASPS_AT_ONCE = 64
"""Grasps that are measured together, which bounds the memory."""

SETTLED = ("motion", "box of the hand", "box of the body", "boxes of its pieces", "query")
"""Reasons why a pair is not near, in this order: the last bound less the motion since, boxes, or a query."""

MANY_PAIRS = 2048
"""Pairs from which on bodies are compared with whole hands first."""

MAX_NEAR = 64
"""Most pairs of a link and a body that count for one grasp, the nearest ones."""


@dataclass(frozen=True, eq=False)
class Nearby:
    """Surroundings of the links of M grasps: witness points of at most K pairs of a link and a body each."""

    T_link: Float[np.ndarray, "M L 4 4"]
    """Poses of the links."""
    bound: Float[np.ndarray, "M C"]
    """Lower bounds of the signed distances of all C pairs in metres; of queried pairs the distance itself."""
    column: Int[np.ndarray, "M K"]
    """Pairs that were queried and are near; -1: none."""
    witness: Witness
    """Witness points (M, K) of links and bodies, object frame; FAR where there is no pair."""

    @property
    def near(self) -> Nearby:
        """The pairs that are near, in as few columns as hold them."""
        width = int((self.column >= 0).sum(axis=1).max(initial=0))
        return Nearby(self.T_link, self.bound, self.column[:, :width], self.witness.pairs(slice(width)))

    @property
    def failed(self) -> Bool[np.ndarray, " M"]:
        """Mask (M,) of grasps with a query that failed."""
        return (self.witness.status > QueryStatus.FAR).any(axis=1)

    @property
    def num_queries(self) -> Int[np.ndarray, " M"]:
        """Narrow-phase queries (M,)."""
        return self.witness.num_queries.sum(axis=1)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """L links of a hand, and the bodies of an environment that they may meet; C = L B pairs, link after link."""

    links: tuple[Body, ...]
    """Bodies of the links."""
    spheres: Float[np.ndarray, "L 4"]
    """Centre and radius of a bounding sphere of each link, link frames, metres."""
    environment: Environment
    """All bodies."""
    chosen: Int[np.ndarray, " B"]
    """Indices of the bodies that count."""
    keeps_margins: bool = True
    """Whether links keep the margins of the bodies; False: no gap."""
    counts: Bool[np.ndarray, " L"] | None = None
    """Mask (L,) of the links that count; None: all."""

    @classmethod
    def measured(
        cls, environment: Environment, links: tuple[Body, ...], counts: Bool[np.ndarray, " L"] | None = None
    ) -> Surroundings | None:
        """Return links and all bodies of an environment, for plain distances without margins; None: there are none."""
        if not environment.bodies or not links:
            return None
        spheres, every = np.array([bounding_sphere(one) for one in links]), np.arange(len(environment.bodies))
        return cls(links, spheres, environment, every, keeps_margins=False, counts=counts)

    @cached_property
    def link(self) -> Int[np.ndarray, " C"]:
        """Link of each pair."""
        return np.repeat(np.arange(len(self.links)), len(self.chosen))

    @cached_property
    def body(self) -> Int[np.ndarray, " C"]:
        """Body of each pair, an index into `chosen`."""
        return np.tile(np.arange(len(self.chosen)), len(self.links))

    @cached_property
    def margin(self) -> Float[np.ndarray, " C"]:
        """Gap of each pair in metres."""
        margins = self.environment.margins[self.chosen]
        return (margins if self.keeps_margins else np.zeros_like(margins))[self.body]

    @cached_property
    def pairs(self) -> Pairs:
        """All pairs of bodies."""
        return Pairs(tuple(self.links[k] for k in self.link), tuple(self._bodies[k] for k in self.body))

    @cached_property
    def _bodies(self) -> list[Body]:
        """The bodies that count; where links keep margins, including obstacles of the lift."""
        around = self.environment
        return [around.cleared(k) if self.keeps_margins else around.bodies[k].body for k in self.chosen.tolist()]

    @cached_property
    def _T_object_body(self) -> Float[np.ndarray, "B 4 4"]:
        return self.environment.T_object_body[self.chosen]

    @cached_property
    def _pieces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Boxes (P, 2, 3) of the pieces in the frames of their bodies, the first piece of each body, and how many."""
        count = np.array([len(body.pieces) for body in self._bodies], dtype=np.int64)
        boxes = np.array([piece.bounds for body in self._bodies for piece in body.pieces]).reshape(-1, 2, 3)
        return boxes, np.cumsum(count) - count, count

    @stage("broad phase")
    def near(
        self,
        T_link: Float[np.ndarray, "M L 4 4"],
        reach: float,
        previous: Nearby | None = None,
        rejected: Bool[np.ndarray, " M"] | None = None,
        most: int = MAX_NEAR,
    ) -> Nearby:
        """Return the pairs whose signed distance, less the margin of the body, is below a reach in metres.

        Args:
            T_link: Poses of the links in the object's frame.
            reach: Distance in metres.
            previous: The last answer for the same grasps.
            rejected: Mask (M,) of grasps that are not queried.
            most: Largest number of pairs of a grasp.

        Numbers of pairs are counted by what settled them (`SETTLED`), for a stopwatch that runs.
        """
        M, C = len(T_link), len(self.link)
        limit = self.margin + reach
        if previous is None:
            bound = np.full((M, C), -np.inf)
        else:
            bound = previous.bound - motion(self.spheres, previous.T_link, T_link)[:, self.link]
        unsure = bound < limit
        if rejected is not None:
            unsure &= ~rejected[:, None]
        known = np.isfinite(T_link).all(axis=(2, 3))
        unsure &= (known if self.counts is None else known & self.counts)[:, self.link]
        left = [M * C, int(np.count_nonzero(unsure))]
        if left[-1] > MANY_PAIRS:
            bound = np.maximum(bound, self._hand_bounds(T_link)[:, self.body])
            unsure &= bound < limit
        row, column = np.nonzero(unsure)
        left.append(len(row))
        for bounds in (self._box_bounds, self._piece_bounds):
            if len(row):
                bound[row, column] = np.maximum(bound[row, column], bounds(T_link, row, column))
                near = bound[row, column] < limit[column]
                row, column = row[near], column[near]
            left.append(len(row))
        settled = [before - after for before, after in zip(left, left[1:], strict=False)]
        count_scene_pairs(dict(zip(SETTLED, (*settled, len(row)), strict=True)))
        width = min(C, most)
        if not len(row):
            return Nearby(T_link, bound, np.full((M, width), -1), _no_witness(M, width))
        T_a, T_b = T_link[row, self.link[column]], self._T_object_body[self.body[column]]
        warm = None if previous is None else _lookup(previous, row, column, C)
        found = query_items(self.pairs, column, T_a, T_b, cutoff=limit[column], previous=warm)
        bound[row, column] = np.where(found.valid | (found.status == QueryStatus.FAR), found.distance, -np.inf)
        kept = np.flatnonzero(found.status != QueryStatus.FAR)
        place = _places(row[kept], found.distance[kept] - self.margin[column[kept]], M)
        kept, place = kept[place < width], place[place < width]
        at = row[kept], place
        columns, witness = np.full((M, width), -1), _no_witness(M, width)
        columns[at] = column[kept]
        for name, values in vars(witness).items():
            values[at] = getattr(found, name)[kept]
        # Queries of pairs that turned out to be far are work, too.
        if width:
            spent = np.bincount(row, found.num_queries, M).astype(np.int64) - witness.num_queries.sum(axis=1)
            witness.num_queries[:, 0] += spent
        return Nearby(T_link, bound, columns, witness)

    def _hand_bounds(self, T_link: np.ndarray) -> np.ndarray:
        """Return lower bounds (M, B) of the distances of bodies from any link, by boxes along the object's axes."""
        counts = slice(None) if self.counts is None else self.counts
        center = transform_points(T_link[:, counts], self.spheres[counts, :3])
        low, high = ((center + sign * self.spheres[counts, 3:]) for sign in (-1.0, 1.0))
        boxes = self.environment.boxes[self.chosen]
        away = np.maximum(boxes[:, 0] - high.max(axis=1)[:, None], low.min(axis=1)[:, None] - boxes[:, 1])
        # Boxes that overlap say nothing on how deep.
        beyond = np.sqrt((np.maximum(away, 0.0) ** 2).sum(axis=-1))
        return np.where(beyond > 0.0, beyond, -np.inf)

    def _box_bounds(self, T_link: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Return lower bounds of signed distances by spheres of links, and boxes of bodies along the object's axes."""
        center = transform_points(T_link, self.spheres[:, :3])[row, self.link[column]]
        boxes = self.environment.boxes[self.chosen][self.body[column]]
        return _outside(center, boxes) - self.spheres[self.link[column], 3]

    def _piece_bounds(self, T_link: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """Return lower bounds of signed distances by spheres of links, and boxes of pieces along their bodies' axes."""
        boxes, first, count = self._pieces
        center = transform_points(T_link, self.spheres[:, :3])[row, self.link[column]]
        body = self.body[column]
        center = transform_points(inverse(self._T_object_body)[body], center)
        each = count[body]
        begin = np.cumsum(each) - each
        piece = np.arange(int(each.sum())) - np.repeat(begin - first[body], each)
        outside = _outside(np.repeat(center, each, axis=0), boxes[piece])
        return np.minimum.reduceat(outside, begin) - self.spheres[self.link[column], 3]


@dataclass(frozen=True, eq=False)
class SceneDepths:
    """Deepest penetration of any link of each of N grasps into a body around the object."""

    depth: Float[np.ndarray, " N"]
    """Depth (N,) in metres; 0 where no link is in any body, NaN where a pose is not finite or a query failed."""
    link: Int[np.ndarray, " N"]
    """Index of that link."""
    body: Int[np.ndarray, " N"]
    """Index of that body."""


def scene_depths(
    environment: Environment,
    links: tuple[Body, ...],
    T_link: Float[np.ndarray, "N L 4 4"],
    counts: Bool[np.ndarray, " L"] | None = None,
) -> SceneDepths:
    """Return the deepest penetration of the links of N grasps into any body, margins aside, by plain queries.

    Args:
        environment: The bodies.
        links: Bodies of the links.
        T_link: Their poses in the object's frame.
        counts: Mask (L,) of the links that count; None: all.
    """
    N = len(T_link)
    depth, link, body = np.zeros(N), np.zeros(N, dtype=np.int64), np.zeros(N, dtype=np.int64)
    spheres = np.array([bounding_sphere(one) for one in links])
    for start in range(0, N, GRASPS_AT_ONCE):
        rows = slice(start, start + GRASPS_AT_ONCE)
        chosen = choose_bodies(environment, spheres, T_link[rows], 0.0)
        if not len(chosen):
            continue
        of = Surroundings(links, spheres, environment, chosen, keeps_margins=False, counts=counts)
        found = of.near(T_link[rows], 0.0, most=1)
        deep = np.where(found.column[:, 0] >= 0, np.maximum(-found.witness.distance[:, 0], 0.0), 0.0)
        depth[rows] = np.where(found.failed, np.nan, deep)
        column = np.maximum(found.column[:, 0], 0)
        link[rows], body[rows] = of.link[column], chosen[of.body[column]]
    finite = np.isfinite(T_link).all(axis=(1, 2, 3))
    return SceneDepths(np.where(finite, depth, np.nan), link, body)


def choose_bodies(
    environment: Environment,
    spheres: Float[np.ndarray, "L 4"],
    T_link: Float[np.ndarray, "M L 4 4"],
    slack: float,
    box: tuple[np.ndarray, np.ndarray] | None = None,
) -> Int[np.ndarray, " B"]:
    """Return the indices of the bodies whose boxes meet the box around all links, and another one, grown by `slack`.

    Args:
        environment: The bodies.
        spheres: Bounding spheres of the links.
        T_link: Their poses; poses that are not finite do not count.
        slack: Metres.
        box: Lower and upper corner (3,) of another box, object frame, metres.
    """
    center = transform_points(T_link, spheres[:, :3])
    low, high = center - spheres[:, 3:], center + spheres[:, 3:]
    finite = np.isfinite(center).all(axis=-1)
    if box is None and not finite.any():
        return np.zeros(0, dtype=np.int64)
    first = np.min([*low[finite], *([] if box is None else [box[0]])], axis=0) - slack
    last = np.max([*high[finite], *([] if box is None else [box[1]])], axis=0) + slack
    boxes = environment.boxes
    return np.flatnonzero(((boxes[:, 0] <= last) & (boxes[:, 1] >= first)).all(axis=1))


def _outside(point: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Return the distances (I,) of points (I, 3) from boxes (I, 2, 3); inside minus the distance from the surface."""
    away = np.maximum(boxes[:, 0] - point, point - boxes[:, 1])
    beyond = np.maximum(away, 0.0)
    return np.sqrt((beyond * beyond).sum(axis=-1)) + np.minimum(away.max(axis=-1), 0.0)


def _no_witness(count: int, width: int) -> Witness:
    """Return FAR answers (M, K) without points."""
    point_a, point_b, normal = np.zeros((3, count, width, 3))
    status = np.full((count, width), QueryStatus.FAR, dtype=np.int8)
    winner, num_queries = np.zeros((2, count, width), dtype=np.int64)
    return Witness(point_a, point_b, normal, np.full((count, width), np.inf), status, winner - 1, num_queries)


def _places(row: np.ndarray, slack: np.ndarray, count: int) -> np.ndarray:
    """Return the place (I,) of each item within its row, by increasing slack."""
    order = np.lexsort((slack, row))
    each = np.bincount(row, minlength=count)
    place = np.empty(len(row), dtype=np.int64)
    place[order] = np.arange(len(row)) - np.repeat(np.cumsum(each) - each, each)
    return place


def _lookup(previous: Nearby, row: np.ndarray, column: np.ndarray, columns: int) -> Witness:
    """Return the last answers of items, by row and pair; FAR where there is none."""
    known = np.flatnonzero(previous.column.reshape(-1) >= 0)
    width = previous.column.shape[1]
    keys = (known // max(width, 1)) * columns + previous.column.reshape(-1)[known]
    order = np.argsort(keys)
    keys, known = keys[order], known[order]
    wanted = row * columns + column
    at = np.minimum(np.searchsorted(keys, wanted), max(len(keys) - 1, 0))
    flat, none = previous.witness.reshape(-1), _no_witness(len(row), 1).reshape(-1)
    if not len(keys):
        return none
    hit = keys[at] == wanted
    for name, values in vars(none).items():
        values[hit] = getattr(flat, name)[known[at[hit]]]
    return none
