"""The narrow phase: closest or deepest points of convex pieces, from coal (GJK and EPA).

With `certified_distance`, the only file that imports coal; `native/narrow_phase.h` is the same in C++. Both guard
against these traps (measured with coal 3.0.3):

- `ComputeDistance` does not keep its geometries alive, so this object does.
- `DistanceResult.normal` is a view into the reused result; it is copied before the next query.
- EPA at tight tolerances sometimes returns an absurd number: a query whose answer is not finite or lies below the
  signed bounding-sphere bound is repeated with a looser tolerance, and reported as failed if that fails too.
- More than 255 neighbours at a vertex raise, and tolerances suit bodies of one size only (see `shapes`).
- Answers that are not certified are resolved (see `certified_distance`).
- A query object searches for support points where its last query found some, so that an answer depends on earlier
  queries, by millimetres where witness points are not unique. Only a request with cached guesses sets the start, so
  every request has them; the query overwrites them with its own, so they are set before each one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import coal
import numpy as np

from grasp_refine.collision.certified_distance import CertifiedQuery, Core, PiecePair, Tolerances
from grasp_refine.collision.shapes import build_shape, unit_of
from grasp_refine.core.profiling import stage
from grasp_refine.geometry.pieces import Piece


def coal_version() -> str:
    """Version of coal's library, as it reports itself."""
    return getattr(coal, "__version__", "of an unknown version")


@dataclass(frozen=True, eq=False)
class Closest:
    """Closest piece pairs of M items, in the frame of each item's body a."""

    distance: np.ndarray
    """Signed distance (M,) in metres; infinite where no piece pair is below the limit."""
    point: np.ndarray
    """Witness point (M, 3) on body a, in metres."""
    normal: np.ndarray
    """Unit normal (M, 3), from body a to body b."""
    winner: np.ndarray
    """Index (M,) of the closest piece pair; -1 where none was found."""
    num_queries: np.ndarray
    """Number of queries (M,)."""
    failed: np.ndarray
    """Mask (M,) of items with a query that could not be answered, so that the minimum is not certain."""


class NarrowPhase:
    """Closest points of listed pairs of convex pieces; pieces and queries are built once and reused."""

    def __init__(self, pieces_a: Sequence[Piece], pieces_b: Sequence[Piece], tolerances: Tolerances) -> None:
        """Prepare the pairs (pieces_a[k], pieces_b[k]), k = 0 .. K - 1."""
        # The pieces keep coal's shapes alive.
        self._keep_alive = (tuple(pieces_a), tuple(pieces_b))
        self._pairs = [_piece_pair(a, b) for a, b in zip(pieces_a, pieces_b, strict=True)]
        self._query = CertifiedQuery(tolerances)

    @stage("narrow phase")
    def closest(
        self,
        R: np.ndarray,
        t: np.ndarray,
        starts: np.ndarray,
        pair: np.ndarray,
        bound: np.ndarray,
        limit: np.ndarray,
        guess: np.ndarray | None = None,
        guess_valid: np.ndarray | None = None,
    ) -> Closest:
        """Return the closest piece pair of each item; pairs whose lower bounds exceed the best so far are not queried.

        Args:
            R: Rotation (M, 3, 3) of body b in the frame of body a.
            t: Its origin (M, 3), in metres.
            starts: Item i may query the entries starts[i] .. starts[i + 1] of `pair` and `bound`.
            pair: Piece pairs, for each item in ascending order of `bound`.
            bound: Lower bound of the signed distance of each entry, in metres.
            limit: Signed distance (M,) in metres that an answer has to be below.
            guess: Last known x_a - x_b in the frame of a (M, 3): a warm start for GJK.
            guess_valid: Mask (M,) of items whose guess is used (they were separated).

        Returns:
            The minimum over the listed piece pairs of each item.
        """
        count = len(R)
        distance = np.full(count, np.inf)
        point, normal = np.zeros((count, 3)), np.zeros((count, 3))
        winner, num_queries = np.full(count, -1), np.zeros(count, dtype=np.int64)
        failed = np.zeros(count, dtype=bool)
        query = self._query
        start_list, pair_list, bound_list, limit_list = (
            starts.tolist(),
            pair.tolist(),
            bound.tolist(),
            limit.tolist(),
        )
        warm_list = guess_valid.tolist() if guess_valid is not None else None
        # Items with the same pieces follow each other, so that these stay in the processor's cache.
        order = np.argsort(pair[starts[:-1]] if (np.diff(starts) > 0).all() else np.zeros(count), kind="stable")
        for i, R_i, t_i in zip(order.tolist(), R[order], t[order], strict=True):
            guess_i = guess[i] if guess is not None and warm_list is not None and warm_list[i] else None
            best, first = limit_list[i], start_list[i]
            stop = start_list[i + 1]
            for j in range(first, stop):
                if bound_list[j] >= best:
                    stop = j
                    break
                piece_pair = self._pairs[pair_list[j]]
                unit = piece_pair.unit
                guess_j = None if guess_i is None else guess_i / unit
                d = unit * query.distance(piece_pair, R_i, t_i / unit, bound_list[j] / unit, guess_j)
                if d != d:
                    failed[i] = True
                elif d < best:
                    best = d
                    distance[i] = d
                    point[i] = unit * query.point
                    normal[i] = query.normal
                    winner[i] = pair_list[j]
            num_queries[i] = stop - first
        return Closest(distance, point, normal, winner, num_queries, failed)


@dataclass(frozen=True, eq=False)
class _ScaledPiece:
    """A piece in a unit of length, for coal."""

    geometry: coal.CollisionGeometry
    """Shape of coal, in the unit."""
    placement: coal.Transform3s | None
    """Pose of the shape in the frame of the body; None: identity."""
    core: Core
    """The piece, in the unit."""


def _piece_pair(a: Piece, b: Piece) -> PiecePair:
    unit = unit_of(a, b)
    first, second = _scaled_piece(a, unit), _scaled_piece(b, unit)
    compute = coal.ComputeDistance(first.geometry, second.geometry)
    T_a = coal.Transform3s() if first.placement is None else first.placement
    return PiecePair(compute, T_a, second.placement, first.core, second.core, unit)


def _scaled_piece(piece: Piece, unit: float) -> _ScaledPiece:
    """Piece with its coal shape, built once for each unit."""
    built = piece.derived.setdefault("coal", {})
    if unit not in built:
        scaled = piece.scaled(1.0 / unit)
        core = Core(np.ascontiguousarray(scaled.vertices.T, dtype=np.float64), scaled.radius)
        built[unit] = _ScaledPiece(*build_shape(scaled, _Factory), core)
    return built[unit]


class _Factory:
    """Factory of coal's shapes with their placements."""

    @staticmethod
    def sphere(radius: float, center: np.ndarray) -> tuple[coal.CollisionGeometry, coal.Transform3s | None]:
        return coal.Sphere(radius), coal.Transform3s(np.eye(3), center)

    @staticmethod
    def capsule(
        radius: float, length: float, frame: np.ndarray, center: np.ndarray
    ) -> tuple[coal.CollisionGeometry, coal.Transform3s | None]:
        return coal.Capsule(radius, length), coal.Transform3s(frame, center)

    @staticmethod
    def hull(vertices: np.ndarray, radius: float) -> tuple[coal.CollisionGeometry, coal.Transform3s | None]:
        return _swept(coal.Convex.convexHull(_points(vertices), True, "Qt"), radius), None

    @staticmethod
    def polytope(
        vertices: np.ndarray, faces: np.ndarray, radius: float
    ) -> tuple[coal.CollisionGeometry, coal.Transform3s | None]:
        triangles = coal.StdVec_Triangle()
        triangles.extend([coal.Triangle(*map(int, face)) for face in faces])
        return _swept(coal.Convex(_points(vertices), triangles), radius), None


def _points(vertices: np.ndarray) -> coal.StdVec_Vec3s:
    points = coal.StdVec_Vec3s()
    points.extend(list(vertices))
    return points


def _swept(shape: coal.ShapeBase, radius: float) -> coal.ShapeBase:
    if radius > 0:
        shape.setSweptSphereRadius(radius)
    return shape
