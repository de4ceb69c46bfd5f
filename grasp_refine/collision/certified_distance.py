"""Certified distance queries of two convex pieces with coal; `native/certified_distance.h` is the same in C++.

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
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import coal
import numpy as np

_MAX_DISTANCE = 1e300
"""Largest absolute distance that counts as an answer."""

_NO_GUESS, _NO_HINT = np.array([1.0, 0.0, 0.0]), np.zeros(2, dtype=np.int32)
"""Start of GJK without a guess, and the two vertices at which its search for support points starts."""

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
_AXES = np.array([sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)])
"""The six directions (6, 3) along axes."""
_EPA_ITERATIONS = 256
"""Iteration limit of EPA: with coal's own of 64, it silently ends at a facet of round bodies that is not nearest."""


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
class Core:
    """A piece in some unit of length: all points within `radius` of the hull of its vertices."""

    vertices: np.ndarray
    """Vertices (3, V), in the unit, in the frame of the body."""
    radius: float
    """Radius in the unit; 0 for a sharp polytope."""

    @cached_property
    def center(self) -> np.ndarray:
        """Centre (3,) of the vertices' bounding box."""
        return 0.5 * (self.vertices.min(axis=1) + self.vertices.max(axis=1))


@dataclass(frozen=True, eq=False)
class PiecePair:
    """A pair of pieces, in a unit of length of its own."""

    compute: Callable[..., float]
    """Distance query of coal."""
    T_a: coal.Transform3s
    """Pose of coal's shape of the first piece in the frame of its body."""
    T_b: coal.Transform3s | None
    """Pose of coal's shape of the second piece in the frame of its body; None: identity."""
    a: Core
    """First piece."""
    b: Core
    """Second piece."""
    unit: float
    """Unit of length, in metres."""

    def gap(self, R: np.ndarray, t: np.ndarray, u: np.ndarray) -> float:
        """Gap g(u) along a unit vector u (3,) in the frame of a; body b is at R (3, 3), t (3,), in the unit."""
        # Sums in a fixed order, here and below: the compiled engine gives the same bits.
        v = u[0] * R[0] + u[1] * R[1] + u[2] * R[2]
        x, y = self.a.vertices, self.b.vertices
        end_a = (u[0] * x[0] + u[1] * x[1] + u[2] * x[2]).max() + self.a.radius
        start_b = (v[0] * y[0] + v[1] * y[1] + v[2] * y[2]).min() - self.b.radius
        return (u[0] * t[0] + u[1] * t[1] + u[2] * t[2]) + start_b - end_a

    def gap_quickly(self, R: np.ndarray, t: np.ndarray, u: np.ndarray) -> float:
        """Gap as in `gap`, up to the last bit, which suffices for comparisons."""
        end_a, start_b = (u @ self.a.vertices).max(), (u @ R @ self.b.vertices).min()
        return float(u @ t + start_b - end_a - (self.a.radius + self.b.radius))

    def between(self, R: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Vector (3,) from the centre of a to that of b, in the frame of a."""
        y = self.b.center
        return R[:, 0] * y[0] + R[:, 1] * y[1] + R[:, 2] * y[2] + t - self.a.center

    def across(self, R: np.ndarray) -> np.ndarray:
        """Vector (3,) perpendicular to the axes of two capsules, in the frame of a; zero for other pieces."""
        x, y = self.a.vertices, self.b.vertices
        if x.shape[1] != 2 or y.shape[1] != 2:
            return np.zeros(3)
        u, w = x[:, 1] - x[:, 0], y[:, 1] - y[:, 0]
        v = R[:, 0] * w[0] + R[:, 1] * w[1] + R[:, 2] * w[2]
        return np.array([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])


@dataclass
class _Ascent:
    """End of an ascent along the normal; in the frame of a, in the unit."""

    gap: float
    """Largest gap reached."""
    normal: np.ndarray
    """Direction (3,) of that gap."""
    point: np.ndarray
    """Witness point (3,) on a."""
    closed: bool
    """Whether GJK's distance there equals the gap."""
    answered: bool
    """Whether GJK gave any answer."""


class CertifiedQuery:
    """Distance queries of piece pairs; each is independent of the queries before it."""

    def __init__(self, tolerances: Tolerances) -> None:
        """Prepare coal's requests."""
        self._tolerances = tolerances
        self._tight = _request(tolerances.gjk, tolerances.epa)
        self._fine = _request(tolerances.gjk, _FINE_EPA_TOLERANCE)
        self._loose = _request(tolerances.retry, tolerances.retry)
        self._result, self._T = coal.DistanceResult(), coal.Transform3s()
        self.point = self.normal = np.zeros(3)
        """Witness point (3,) on a, in the unit, and normal (3,) of the last answer; in the frame of a."""

    def distance(self, pair: PiecePair, R: np.ndarray, t: np.ndarray, bound: float, guess: np.ndarray | None) -> float:
        """Return the signed distance in the unit of the pieces; NaN if no answer is usable.

        Args:
            pair: The pieces.
            R: Rotation (3, 3) of body b in the frame of body a.
            t: Its origin (3,), in the unit.
            bound: A lower bound of the signed distance, in the unit.
            guess: Last known x_a - x_b (3,), in the unit.
        """
        # An answer is limited even without a bound.
        floor = max(bound - self._tolerances.slack, -_MAX_DISTANCE)
        self._T.setRotation(R)
        d = self._query_pieces(pair, t, self._tight, _NO_GUESS if guess is None else guess)
        if not (floor <= d < _MAX_DISTANCE):
            d = self._query_pieces(pair, t, self._loose, _NO_GUESS)
            if not (floor <= d < _MAX_DISTANCE):
                d = np.nan
        if abs(d) > _CONTACT_DISTANCE and self._is_certified(pair, R, t, d):
            return d
        d = self._resolve(pair, R, t, d)
        return d if d >= floor else np.nan

    def _is_certified(self, pair: PiecePair, R: np.ndarray, t: np.ndarray, d: float) -> bool:
        """Return whether the gap along coal's normal is d."""
        return bool(abs(d - pair.gap_quickly(R, t, self.normal)) <= _GAP_TOLERANCE and self._has_normal())

    def _has_normal(self) -> bool:
        """Return whether coal's normal has length 1; it is zero where the axes of capsules meet."""
        return bool(abs(_square(self.normal) - 1.0) <= _UNIT_TOLERANCE)

    def _query_pieces(self, pair: PiecePair, t: np.ndarray, request: coal.DistanceRequest, guess: np.ndarray) -> float:
        """Return coal's unchecked answer for body b at t (3,)."""
        T, result = self._T, self._result
        T.setTranslation(t)
        request.cached_gjk_guess, request.cached_support_func_guess = guess, _NO_HINT
        result.clear()
        d = pair.compute(pair.T_a, T if pair.T_b is None else T * pair.T_b, request, result)
        self.point, self.normal = result.getNearestPoint1(), result.normal.copy()
        return d

    def _resolve(self, pair: PiecePair, R: np.ndarray, t: np.ndarray, d: float) -> float:
        """Return the largest gap found, where coal's distance d (NaN: none) is not certified."""
        close = 0.5 * self._tolerances.gjk * (1.0 + abs(d))
        starts = self._starts(pair, R, t)
        best = self._ascend_separation(pair, R, t, starts[0])

        def sure() -> bool:
            # Otherwise there may be a larger gap in another direction.
            return bool(best.closed and (abs(d - best.gap) <= close or (math.isnan(d) and best.gap > 0.0)))

        if d <= _CONTACT_DISTANCE and not sure():
            self._query_pieces(pair, t, self._fine, _NO_GUESS)
            if self._has_normal():
                starts.insert(1, self.normal)
        for k in range(1, len(starts) + len(_AXES)):
            if sure():
                break
            u = starts[k] if k < len(starts) else _normalized(best.normal + _SIDE_OFFSET * _AXES[k - len(starts)])
            found = self._ascend_separation(pair, R, t, u)
            if found.gap > best.gap:
                best = found
        if not best.answered or (math.isnan(d) and not best.closed):
            return math.nan
        self.point, self.normal = best.point, best.normal
        return best.gap

    def _starts(self, pair: PiecePair, R: np.ndarray, t: np.ndarray) -> list[np.ndarray]:
        """Starting directions: coal's normal, across two capsules, the line between the centres, and the axes."""
        across, m = pair.across(R), pair.between(R, t)
        starts = [self.normal] if self._has_normal() else []
        starts += [_normalized(u) for u in (across, m) if _square(u) > _MIN_LENGTH**2]
        return [*starts, *_AXES]

    def _ascend_separation(self, pair: PiecePair, R: np.ndarray, t: np.ndarray, u: np.ndarray) -> _Ascent:
        """Follow the normal from the direction u until the gap stops growing."""
        found = _Ascent(pair.gap(R, t, u), u, np.zeros(3), closed=False, answered=False)
        for apart in _QUERY_GAPS:
            for _ in range(_MAX_ITERATIONS):
                u, move = found.normal, apart - found.gap
                d = self._query_pieces(pair, t + move * u, self._tight, -apart * u)
                if not (0.0 < d < _MAX_DISTANCE):
                    break
                found.point, found.answered = self.point, True
                found.closed = abs(d - move - found.gap) <= _GAP_TOLERANCE
                n = self.normal
                gap = pair.gap(R, t, n)
                if found.gap > 1.0:
                    # Far apart, a small turn has a large effect: the turn to the line between the points counts.
                    turn = _normalized(d * n - move * u) - u
                    for step in _STEP_LENGTHS:
                        w = _normalized(u + step * turn)
                        along = pair.gap(R, t, w)
                        if along > gap:
                            n, gap = w, along
                if not gap > found.gap + 1e-14:
                    break
                found.gap, found.normal = gap, n
        return found


def _normalized(u: np.ndarray) -> np.ndarray:
    return u / np.sqrt(_square(u))


def _square(u: np.ndarray) -> float:
    # In a fixed order, see `PiecePair.gap`.
    return u[0] * u[0] + u[1] * u[1] + u[2] * u[2]


def _request(gjk_tolerance: float, epa_tolerance: float) -> coal.DistanceRequest:
    """Return a request that starts from its cached guesses, which every query overwrites with its own."""
    request = coal.DistanceRequest()
    request.gjk_tolerance = gjk_tolerance
    request.epa_tolerance = epa_tolerance
    request.epa_max_iterations = _EPA_ITERATIONS
    request.gjk_initial_guess = coal.GJKInitialGuess.CachedGuess
    return request
