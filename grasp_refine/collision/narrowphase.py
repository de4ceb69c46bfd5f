"""The narrow phase: closest or deepest points of convex pieces, asked from coal (GJK and EPA).

The only file that imports coal; `native/narrow_phase.h` is the same in C++. What both guard against (measured with
coal 3.0.3):

- `ComputeDistance` does not keep its geometries alive, so this object does.
- `DistanceResult.normal` is a view into the reused result; it is copied before the next query.
- EPA at tight tolerances sometimes ends with a wild number: an answer that is not finite or lies below the
  signed bounding-sphere bound is asked again with a looser tolerance, and reported as failed if that fails too.
- More than 255 neighbours at a vertex raise, and tolerances suit bodies of one size only (see `shapes`).
- GJK's tolerance grows with the distance: bodies far apart are asked about again, with a tighter one.
- A query object looks for support points where its last query found some, so that an answer depends on what was
  asked before, by millimetres where witness points are not unique. Only a request with cached guesses says where
  to begin, so every request has them; the query writes its own over them, so they are set before each one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import coal
import numpy as np

from grasp_refine.collision.shapes import build_shape, unit_of
from grasp_refine.geometry.pieces import Piece
from grasp_refine.stopwatch import stage

_WILD = 1e300
"""A distance beyond this, either way, is no answer."""

_DISTANT = 2.0
"""Beyond this distance, in units of the pieces, GJK's answer is asked for again. As `kDistant` of `native/narrow_phase.h`."""

_NO_GUESS, _NO_HINT = np.array([1.0, 0.0, 0.0]), np.zeros(2, dtype=np.int32)
"""Where GJK begins without a guess, and at which two vertices it begins to look for support points."""


def coal_version() -> str:
    """The version of coal's library, as it says itself."""
    return getattr(coal, "__version__", "of an unknown version")


@dataclass(frozen=True)
class Tolerances:
    """Convergence tolerances of the two algorithms, in the units of the pieces (see `shapes.unit_of`)."""

    gjk: float = 1e-9
    """Duality gap of GJK (separated pieces)."""
    epa: float = 1e-8
    """Gap of EPA (penetrating pieces)."""
    retry: float = 1e-6
    """Tolerance of both for the second try of a query whose first answer was not usable."""
    slack: float = 1e-6
    """How far an answer may lie below its lower bound before it counts as wrong."""


@dataclass(frozen=True, eq=False)
class Closest:
    """What the narrow phase found for M items, in the frame of each item's body a."""

    distance: np.ndarray
    """Signed distance (M,) in metres; infinite where no piece pair beat the given limit."""
    point: np.ndarray
    """Witness point (M, 3) on body a."""
    normal: np.ndarray
    """Unit normal (M, 3), from body a to body b."""
    winner: np.ndarray
    """The piece pair (M,) that is closest; -1 where none was found."""
    asked: np.ndarray
    """Number of queries (M,) that were asked."""
    failed: np.ndarray
    """Items (M,) for which at least one query could not be answered, so that the minimum is not certain."""


class NarrowPhase:
    """Closest points of listed pairs of convex pieces; pieces and queries are built once and reused."""

    def __init__(self, pieces_a: Sequence[Piece], pieces_b: Sequence[Piece], tolerances: Tolerances) -> None:
        """Prepare the pairs (pieces_a[k], pieces_b[k]), k = 0 .. K - 1."""
        # The pieces keep their shapes alive.
        self._keep_alive = (tuple(pieces_a), tuple(pieces_b))
        identity = coal.Transform3s()
        self._pairs = []
        for a, b in zip(pieces_a, pieces_b, strict=True):
            unit = unit_of(a, b)
            (shape_a, T_a), (shape_b, T_b) = _shape_of(a, unit), _shape_of(b, unit)
            self._pairs.append((coal.ComputeDistance(shape_a, shape_b), T_a or identity, T_b, unit))
        self._tolerances = tolerances
        self._request = _request(tolerances.gjk, tolerances.epa)
        self._far_request = _request(tolerances.gjk, tolerances.epa)
        self._loose_request = _request(tolerances.retry, tolerances.retry)

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
        """The closest piece pair of each item, asking no pair whose lower bound cannot beat the best so far.

        Args:
            R: Rotation (M, 3, 3) of body b in the frame of body a.
            t: Its origin (M, 3).
            starts: Item i may ask the entries starts[i] .. starts[i + 1] of `pair` and `bound`.
            pair: Piece pairs, for each item in ascending order of `bound`.
            bound: Lower bound of the signed distance of each entry.
            limit: Signed distance (M,) that an answer has to beat.
            guess: Last seen x_a - x_b in the frame of a (M, 3): a warm start for GJK.
            guess_valid: Items (M,) whose guess is used (they were last seen apart).

        Returns:
            The minimum over the listed pieces of each item.
        """
        count = len(R)
        distance = np.full(count, np.inf)
        point, normal = np.zeros((count, 3)), np.zeros((count, 3))
        winner, asked = np.full(count, -1), np.zeros(count, dtype=np.int64)
        failed = np.zeros(count, dtype=bool)
        result, T = coal.DistanceResult(), coal.Transform3s()
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
            T.setRotation(R_i)
            guess_i = guess[i] if warm_list is not None and warm_list[i] else None
            best, first = limit_list[i], start_list[i]
            stop = start_list[i + 1]
            for j in range(first, stop):
                if bound_list[j] >= best:
                    stop = j
                    break
                compute, T_a, T_b, unit = self._pairs[pair_list[j]]
                T.setTranslation(t_i / unit)
                placed = T if T_b is None else T * T_b
                start = _NO_GUESS if guess_i is None else guess_i / unit
                d = unit * self._distance(compute, T_a, placed, bound_list[j] / unit, start, result)
                if d != d:
                    failed[i] = True
                elif d < best:
                    best = d
                    distance[i] = d
                    point[i] = unit * result.getNearestPoint1()
                    normal[i] = result.normal
                    winner[i] = pair_list[j]
            asked[i] = stop - first
        return Closest(distance, point, normal, winner, asked, failed)

    def _distance(
        self,
        compute: Callable[..., float],
        T_a: coal.Transform3s,
        T_b: coal.Transform3s,
        bound: float,
        guess: np.ndarray,
        result: coal.DistanceResult,
    ) -> float:
        """The signed distance of two pieces in their unit, at least `bound`; NaN if no answer is usable."""

        def ask(request: coal.DistanceRequest, guess: np.ndarray) -> float:
            request.cached_gjk_guess, request.cached_support_func_guess = guess, _NO_HINT
            result.clear()
            return compute(T_a, T_b, request, result)

        # Without a bound, too, there is a limit to what an answer can be.
        floor, tight, gjk = max(bound - self._tolerances.slack, -_WILD), self._request, self._tolerances.gjk
        d = ask(tight, guess)
        if not (floor <= d < _WILD):
            d = ask(self._loose_request, _NO_GUESS)
            return d if floor <= d < _WILD else np.nan
        if d > _DISTANT:
            self._far_request.gjk_tolerance = gjk / (1.0 + d)
            closer = ask(self._far_request, -d * result.normal)
            # Too tight a tolerance may have no answer.
            return closer if d - 2.0 * gjk * (1.0 + d) <= closer <= d else ask(tight, guess)
        return d


def _request(gjk_tolerance: float, epa_tolerance: float) -> coal.DistanceRequest:
    """A request that starts from the guesses it holds, which every query overwrites with its own."""
    request = coal.DistanceRequest()
    request.gjk_tolerance = gjk_tolerance
    request.epa_tolerance = epa_tolerance
    request.gjk_initial_guess = coal.GJKInitialGuess.CachedGuess
    return request


def _shape_of(piece: Piece, unit: float) -> tuple[coal.CollisionGeometry, coal.Transform3s | None]:
    """The coal shape of a piece in a unit, and its placement in the body (None: its own frame), built once."""
    shapes = piece.derived.setdefault("coal", {})
    if unit not in shapes:
        shapes[unit] = build_shape(piece, unit, _Factory)
    return shapes[unit]


class _Factory:
    """Shapes of coal with their placements."""

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
