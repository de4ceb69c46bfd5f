"""Certified distance queries of two convex pieces with coal (GJK and EPA): the plain form, for the engine in Python.

`native/certified_distance.h` does the same in C++, faster, and is the norm where rounding differs.

For every unit direction u the gap

    g(u) = min_b u . y - max_a u . x

is at most the signed distance, separated and in penetration, and the largest gap is the signed distance. So an answer
with distance d and normal n must have g(n) = d, which is checked. For separated pieces that certifies it. In
penetration it certifies that d is not too shallow; it is not too deep, because EPA's polytope lies within the
difference of the pieces, so that its nearest facet is no farther than theirs, if the origin is in both, which rounding
may violate near contact. GJK and EPA fail the check now and then: far apart, where GJK's tolerance grows with the
distance; for slivers and nearly equal vertices; where the axes of two capsules cross; and within GJK's tolerance of
contact, where the normal is only rounding, and gaps below it count as contact.

Where an answer fails, b is moved along u until the gap is a quarter of the pieces' unit, where GJK is most accurate.
If u is right, so is the closest pair of points there: the move adds its length to g(u), and less to all other gaps. If
not, the normal there is a better direction. It is followed until the gap stops growing; then again from a smaller gap,
because a small rotation moves points less there. Where pieces touch or penetrate, EPA's normal at a finer tolerance is
a second starting direction.

The resolved answer is the largest gap found, which is not certified: of gaps from 1e-12 to 1e-9 of the larger
piece, about 1 % are returned as contact, and up to 1 in 5 for slivers and nearly equal vertices. About 1 in 10,000
answers within 1e-5 of contact is off by up to 2e-7, most of them where sizes differ by more than 1:10,000.

Traps of coal (measured with version 3.0.3) that both engines avoid:

- `DistanceResult.normal` is a view into the result; it is copied.
- EPA at tight tolerances sometimes returns an absurd number: a query whose answer is not finite or lies below the
  signed bounding-sphere bound is repeated with a looser tolerance, and reported as failed if that fails too.
- More than 255 neighbours at a vertex raise, and tolerances suit bodies of one size only (see `shapes`).
- A query object searches for support points where its last query found some, so that an answer depends on earlier
  queries, by millimetres where witness points are not unique. So each query has objects of its own.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import coal
import numpy as np

from grasp_refine.collision.shapes import build_shape, unit_of
from grasp_refine.geometry.pieces import Piece

_MAX_DISTANCE = 1e300
"""Largest absolute distance that counts as an answer."""

# The same constants are in `native/certified_distance.h`; lengths are in units of the pieces.
_GAP_TOLERANCE = 1e-10
"""Largest difference between a gap and the distance that it certifies."""
_CONTACT_DISTANCE = 4e-9
"""Absolute distance within which GJK reports contact, at the default tolerance."""
_QUERY_GAPS = (0.25, 2.0**-14)
"""Gaps at which GJK is queried again, one after the other."""
_MAX_ITERATIONS = 32
"""Most iterations along the normal at each of these gaps."""
_STEP_LENGTHS = (1.0, 8.0, 64.0, 512.0)
"""Lengths of the steps along a turn: to its end, and beyond, because slivers need many such steps."""
_MIN_LENGTH = 1e-12
"""Length below which a vector has no direction."""
_FINE_EPA_TOLERANCE = 1e-10
"""EPA's tolerance for a second starting direction: 1e-8 is coarse for a piece much smaller than the unit."""
_UNIT_TOLERANCE = 1e-6
"""Largest deviation of a normal's squared length from 1."""
_SIDE_OFFSET = 0.25
"""Offset of further starting directions from the best one so far."""
_EPA_ITERATIONS = 256
"""Iteration limit of EPA: with coal's own of 64, it silently ends at a facet of round bodies that is not nearest."""

_AXES = np.array([sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)])
"""The six directions (6, 3) along axes."""


def coal_version() -> str:
    """Version of coal's library, as it reports itself."""
    return getattr(coal, "__version__", "of an unknown version")


@dataclass(frozen=True)
class Tolerances:
    """Convergence tolerances of GJK and EPA, in the units of the pieces (see `shapes.unit_of`)."""

    gjk: float = 1e-9
    """Duality gap of GJK (separated pieces)."""
    epa: float = 1e-8
    """Gap of EPA (penetrating pieces)."""
    retry: float = 1e-6
    """Tolerance of both for the second attempt at a query whose first answer was not usable."""
    slack: float = 1e-6
    """Largest amount by which a usable answer may lie below its lower bound."""


@dataclass(frozen=True, eq=False)
class Answer:
    """Closest or deepest points of two pieces, in the frame of body a."""

    distance: float
    """Signed distance; NaN if no answer is usable."""
    point: np.ndarray
    """Witness point (3,) on a."""
    normal: np.ndarray
    """Unit normal (3,) from a to b."""

    @property
    def has_normal(self) -> bool:
        """Whether the normal has length 1; coal's is zero where the axes of capsules meet."""
        return bool(abs(self.normal @ self.normal - 1.0) <= _UNIT_TOLERANCE)


@dataclass(frozen=True, eq=False)
class _Shape:
    """A piece in some unit of length, for coal."""

    geometry: coal.CollisionGeometry
    """Shape of coal."""
    placement: coal.Transform3s
    """Its pose in the frame of the body."""
    piece: Piece
    """The piece."""


@dataclass(frozen=True, eq=False)
class _Ascent(Answer):
    """End of an ascent along the normal; the distance is the largest gap."""

    closed: bool = False
    """Whether GJK's distance there equals the gap."""
    answered: bool = False
    """Whether GJK gave any answer."""


class PiecePair:
    """Distance queries of two pieces; each is independent of the queries before it."""

    def __init__(self, a: Piece, b: Piece, tolerances: Tolerances) -> None:
        """Build the shapes, which the pieces keep."""
        self._unit, self._tolerances = unit_of(a, b), tolerances
        self._a, self._b = _shape(a, self._unit), _shape(b, self._unit)

    def distance(self, R: np.ndarray, t: np.ndarray, bound: float, guess: np.ndarray | None) -> Answer:
        """Return the signed distance and the closest or deepest point, in metres.

        Args:
            R: Rotation (3, 3) of body b in the frame of body a.
            t: Its origin (3,), in metres.
            bound: A lower bound of the signed distance, in metres.
            guess: Last known x_a - x_b (3,) in metres: a warm start for GJK.
        """
        t, guess = t / self._unit, None if guess is None else guess / self._unit
        # An answer is limited even without a bound.
        floor = max(bound / self._unit - self._tolerances.slack, -_MAX_DISTANCE)
        found = self._query(R, t, guess=guess)
        if not floor <= found.distance < _MAX_DISTANCE:
            found = self._query(R, t, self._tolerances.retry, self._tolerances.retry)
            if not floor <= found.distance < _MAX_DISTANCE:
                found = replace(found, distance=np.nan)
        d = found.distance
        certified = found.has_normal and abs(d - self._gap(R, t, found.normal)) <= _GAP_TOLERANCE
        if not (certified and abs(d) > _CONTACT_DISTANCE):
            found = self._resolve(R, t, found)
        usable = found.distance >= floor
        return Answer(self._unit * found.distance if usable else np.nan, self._unit * found.point, found.normal)

    def _query(
        self,
        R: np.ndarray,
        t: np.ndarray,
        gjk: float | None = None,
        epa: float | None = None,
        guess: np.ndarray | None = None,
    ) -> Answer:
        """Return coal's unchecked answer in the unit, by default at the tolerances of the query."""
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        request.gjk_tolerance = self._tolerances.gjk if gjk is None else gjk
        request.epa_tolerance = self._tolerances.epa if epa is None else epa
        request.epa_max_iterations = _EPA_ITERATIONS
        request.gjk_initial_guess = coal.GJKInitialGuess.CachedGuess
        request.cached_gjk_guess = np.array([1.0, 0.0, 0.0]) if guess is None else guess
        T_b = coal.Transform3s(R, t) * self._b.placement
        d = coal.distance(self._a.geometry, self._a.placement, self._b.geometry, T_b, request, result)
        return Answer(d, result.getNearestPoint1(), result.normal.copy())

    def _gap(self, R: np.ndarray, t: np.ndarray, u: np.ndarray) -> float:
        """Gap g(u) along a unit vector u (3,) in the frame of a."""
        a, b = self._a.piece, self._b.piece
        return float(u @ t + (b.vertices @ (u @ R)).min() - b.radius - (a.vertices @ u).max() - a.radius)

    def _resolve(self, R: np.ndarray, t: np.ndarray, found: Answer) -> Answer:
        """Return the largest gap found, where coal's answer (distance NaN: none) is not certified."""
        d = found.distance
        best = _Ascent(-np.inf, found.point, found.normal)
        for u in self._starts(R, t, found):
            best = max(best, self._ascend_separation(R, t, u), key=lambda ascent: ascent.distance)
            # Otherwise there may be a larger gap in another direction.
            if best.closed and (
                abs(d - best.distance) <= 0.5 * self._tolerances.gjk * (1.0 + abs(d))
                or (np.isnan(d) and best.distance > 0.0)
            ):
                return best
        for side in _SIDE_OFFSET * _AXES:
            ascent = self._ascend_separation(R, t, _normalized(best.normal + side))
            best = max(best, ascent, key=lambda ascent: ascent.distance)
        return best if best.answered and (best.closed or not np.isnan(d)) else replace(best, distance=np.nan)

    def _starts(self, R: np.ndarray, t: np.ndarray, found: Answer) -> Iterator[np.ndarray]:
        """Yield starting directions: coal's normals, across two capsules, between the centres, and the axes."""
        if found.has_normal:
            yield found.normal
        if found.distance <= _CONTACT_DISTANCE:
            fine = self._query(R, t, epa=_FINE_EPA_TOLERANCE)
            if fine.has_normal:
                yield fine.normal
        a, b = self._a.piece, self._b.piece
        directions = [R @ b.bounds.mean(axis=0) + t - a.bounds.mean(axis=0)]
        if len(a.vertices) == len(b.vertices) == 2:
            directions.insert(0, np.cross(a.vertices[1] - a.vertices[0], R @ (b.vertices[1] - b.vertices[0])))
        yield from (_normalized(u) for u in directions if np.linalg.norm(u) > _MIN_LENGTH)
        yield from _AXES

    def _ascend_separation(self, R: np.ndarray, t: np.ndarray, u: np.ndarray) -> _Ascent:
        """Follow the normal from the direction u until the gap stops growing."""
        best = _Ascent(self._gap(R, t, u), np.zeros(3), u)
        for apart in _QUERY_GAPS:
            for _ in range(_MAX_ITERATIONS):
                u, move = best.normal, apart - best.distance
                moved = self._query(R, t + move * u, guess=-apart * u)
                if not 0.0 < moved.distance < _MAX_DISTANCE:
                    break
                closed = abs(moved.distance - move - best.distance) <= _GAP_TOLERANCE
                best = _Ascent(best.distance, moved.point, u, closed, answered=True)
                directions = [moved.normal]
                if best.distance > 1.0:
                    # Far apart, a small turn has a large effect: the turn to the line between the points counts.
                    turn = _normalized(moved.distance * moved.normal - move * u) - u
                    directions += [_normalized(u + step * turn) for step in _STEP_LENGTHS]
                gap, n = max(((self._gap(R, t, n), n) for n in directions), key=lambda pair: pair[0])
                if not gap > best.distance + 1e-14:
                    break
                best = replace(best, distance=gap, normal=n)
        return best


def _normalized(u: np.ndarray) -> np.ndarray:
    return u / np.linalg.norm(u)


def _shape(piece: Piece, unit: float) -> _Shape:
    """Shape of a piece in a unit of length, built once."""
    shapes = piece.derived.setdefault("coal", {})
    if unit not in shapes:
        scaled = piece.scaled(1.0 / unit)
        shapes[unit] = _Shape(*build_shape(scaled, _Factory), scaled)
    return shapes[unit]


class _Factory:
    """Factory of coal's shapes with their placements."""

    @staticmethod
    def sphere(radius: float, center: np.ndarray) -> tuple[coal.ShapeBase, coal.Transform3s]:
        return coal.Sphere(radius), coal.Transform3s(np.eye(3), center)

    @staticmethod
    def capsule(
        radius: float, length: float, frame: np.ndarray, center: np.ndarray
    ) -> tuple[coal.ShapeBase, coal.Transform3s]:
        return coal.Capsule(radius, length), coal.Transform3s(frame, center)

    @staticmethod
    def hull(vertices: np.ndarray, radius: float) -> tuple[coal.ShapeBase, coal.Transform3s]:
        return _swept(coal.Convex.convexHull(_points(vertices), True, "Qt"), radius)

    @staticmethod
    def polytope(vertices: np.ndarray, faces: np.ndarray, radius: float) -> tuple[coal.ShapeBase, coal.Transform3s]:
        triangles = coal.StdVec_Triangle()
        triangles.extend([coal.Triangle(*map(int, face)) for face in faces])
        return _swept(coal.Convex(_points(vertices), triangles), radius)


def _points(vertices: np.ndarray) -> coal.StdVec_Vec3s:
    points = coal.StdVec_Vec3s()
    points.extend(list(vertices))
    return points


def _swept(shape: coal.ShapeBase, radius: float) -> tuple[coal.ShapeBase, coal.Transform3s]:
    if radius > 0:
        shape.setSweptSphereRadius(radius)
    return shape, coal.Transform3s()
