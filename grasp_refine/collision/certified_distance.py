"""Asking coal about two convex pieces, and making sure of its answer; `native/certified_distance.h` is the same in C++.

For every unit direction u the gap

    g(u) = min_b u . y - max_a u . x

is at most the signed distance, apart and in penetration, and the largest gap is the signed distance. So an answer
with distance d and normal n must have g(n) = d, which is checked. Apart, that proves it. In penetration it proves
that d is not too shallow; it is not too deep, because EPA's polytope lies within the difference of the pieces, so that
its nearest facet is no farther than theirs, if the origin is in both, which rounding may deny near contact. GJK and EPA
miss it now and then: far apart, where GJK's tolerance grows with the distance; for slivers and nearly equal vertices;
where the axes of two capsules cross; and within GJK's tolerance of contact, where the normal is rounding only, and gaps
below it pass for contact.

Where an answer does not hold, b is moved along u until the gap is a quarter of the pieces' unit, where GJK is at its
best. If u is right, so is the closest pair of points there: the move adds to g(u) what it is long, and less to all
other gaps. If not, the normal there is a better direction. It is followed until the gap grows no more; then again
from nearer, because a small turn moves points less there. Where pieces touch or penetrate, EPA's normal at a finer
tolerance is a second direction to begin with.

What is settled so is the largest gap that was found, which is no proof: of gaps from 1e-12 to 1e-9 of the larger
piece, about 1 % come back as contact, and up to 1 in 5 for slivers and nearly equal vertices. About 1 in 10,000 answers
within 1e-5 of contact is off by up to 2e-7, most of them where sizes differ by more than 1:10,000.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import coal
import numpy as np

_WILD = 1e300
"""A distance beyond this, either way, is no answer."""

_NO_GUESS, _NO_HINT = np.array([1.0, 0.0, 0.0]), np.zeros(2, dtype=np.int32)
"""Where GJK begins without a guess, and at which two vertices it begins to look for support points."""

# The same constants are in `native/certified_distance.h`; all are in units of the pieces.
_SURE = 1e-10
"""How far a gap may lie below the distance that it proves."""
_TOUCHING = 4e-9
"""A distance within this is contact to GJK, at the default tolerance."""
_APART = (0.25, 2.0**-14)
"""The gaps at which GJK is asked again, one after the other."""
_ROUNDS = 32
"""How often the normal is followed at most at each of them."""
_STEPS = (1.0, 8.0, 64.0, 512.0)
"""How far that way is followed: to its end, and beyond, because slivers have many such steps to go."""
_NOTHING = 1e-12
"""The length of a vector that has no direction."""
_FINE_EPA = 1e-10
"""EPA's tolerance for another direction to begin with: 1e-8 is coarse to a piece that is far smaller than the unit."""
_UNIT = 1e-6
"""How far the square of a normal may be from 1."""
_ASIDE = 0.25
"""How far from the best direction so far others are tried."""
_AXES = np.array([sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)])
"""The six directions (6, 3) along axes."""
_EPA_ITERATIONS = 256
"""With coal's own limit of 64, EPA ends at a facet that is not the nearest one of round bodies, and says nothing."""


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
class Core:
    """A piece in some unit of length: all points within `radius` of the hull of some vertices."""

    vertices: np.ndarray
    """(3, V), in the frame of the body."""
    radius: float

    @cached_property
    def center(self) -> np.ndarray:
        """The middle (3,) of the box around the vertices."""
        return 0.5 * (self.vertices.min(axis=1) + self.vertices.max(axis=1))


@dataclass(frozen=True, eq=False)
class PiecePair:
    """Two pieces that are asked together, in a unit of length of their own."""

    compute: Callable[..., float]
    """coal's query."""
    T_a: coal.Transform3s
    """Where coal's shape of the first piece is in its body."""
    T_b: coal.Transform3s | None
    """The same of the second one; None: where the body is."""
    a: Core
    b: Core
    unit: float
    """In metres."""

    def gap(self, R: np.ndarray, t: np.ndarray, u: np.ndarray) -> float:
        """The gap g(u) along a unit vector u (3,) in the frame of a; body b is at R (3, 3), t (3,), in the unit."""
        # Sums in a fixed order, here and below: the compiled engine has the same bits.
        v = u[0] * R[0] + u[1] * R[1] + u[2] * R[2]
        x, y = self.a.vertices, self.b.vertices
        end_a = (u[0] * x[0] + u[1] * x[1] + u[2] * x[2]).max() + self.a.radius
        start_b = (v[0] * y[0] + v[1] * y[1] + v[2] * y[2]).min() - self.b.radius
        return (u[0] * t[0] + u[1] * t[1] + u[2] * t[2]) + start_b - end_a

    def gap_quickly(self, R: np.ndarray, t: np.ndarray, u: np.ndarray) -> float:
        """The same up to the last bit, which is enough to compare it with something."""
        end_a, start_b = (u @ self.a.vertices).max(), (u @ R @ self.b.vertices).min()
        return float(u @ t + start_b - end_a - (self.a.radius + self.b.radius))

    def between(self, R: np.ndarray, t: np.ndarray) -> np.ndarray:
        """From the centre of a to that of b (3,), in the frame of a."""
        y = self.b.center
        return R[:, 0] * y[0] + R[:, 1] * y[1] + R[:, 2] * y[2] + t - self.a.center

    def across(self, R: np.ndarray) -> np.ndarray:
        """A vector (3,) perpendicular to the axes of two capsules, in the frame of a; zero for other pieces."""
        x, y = self.a.vertices, self.b.vertices
        if x.shape[1] != 2 or y.shape[1] != 2:
            return np.zeros(3)
        u, w = x[:, 1] - x[:, 0], y[:, 1] - y[:, 0]
        v = R[:, 0] * w[0] + R[:, 1] * w[1] + R[:, 2] * w[2]
        return np.array([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])


@dataclass
class _Ascent:
    """Where following the normal ended."""

    gap: float
    normal: np.ndarray
    point: np.ndarray
    closed: bool
    """Whether GJK found nothing nearer than the gap there."""
    answered: bool
    """Whether GJK found anything."""


class CertifiedQuery:
    """What asks; of two questions the second does not see what the first one left."""

    def __init__(self, tolerances: Tolerances) -> None:
        """Prepare the requests."""
        self._tolerances = tolerances
        self._tight = _request(tolerances.gjk, tolerances.epa)
        self._fine = _request(tolerances.gjk, _FINE_EPA)
        self._loose = _request(tolerances.retry, tolerances.retry)
        self._result, self._T = coal.DistanceResult(), coal.Transform3s()
        self.point = self.normal = np.zeros(3)
        """Of the last answer: witness point (3,) on a, in the unit, and normal (3,); in the frame of a."""

    def distance(self, pair: PiecePair, R: np.ndarray, t: np.ndarray, bound: float, guess: np.ndarray | None) -> float:
        """The signed distance in the unit of the pieces; NaN if no answer is usable.

        Args:
            pair: The pieces.
            R: Rotation (3, 3) of body b in the frame of body a.
            t: Its origin (3,), in the unit.
            bound: A lower bound of the signed distance, in the unit.
            guess: Last seen x_a - x_b (3,), in the unit.
        """
        # Without a bound, too, there is a limit to what an answer can be.
        floor = max(bound - self._tolerances.slack, -_WILD)
        self._T.setRotation(R)
        d = self._query_pieces(pair, t, self._tight, _NO_GUESS if guess is None else guess)
        if not (floor <= d < _WILD):
            d = self._query_pieces(pair, t, self._loose, _NO_GUESS)
            if not (floor <= d < _WILD):
                d = np.nan
        if abs(d) > _TOUCHING and self._is_proven(pair, R, t, d):
            return d
        d = self._resolve(pair, R, t, d)
        return d if d >= floor else np.nan

    def _is_proven(self, pair: PiecePair, R: np.ndarray, t: np.ndarray, d: float) -> bool:
        """Whether the gap along coal's normal is d."""
        return bool(abs(d - pair.gap_quickly(R, t, self.normal)) <= _SURE and self._has_normal())

    def _has_normal(self) -> bool:
        """Whether coal's normal has length 1; it is zero where the axes of capsules meet."""
        return bool(abs(_square(self.normal) - 1.0) <= _UNIT)

    def _query_pieces(self, pair: PiecePair, t: np.ndarray, request: coal.DistanceRequest, guess: np.ndarray) -> float:
        """Coal's answer for body b at t (3,), as it is."""
        T, result = self._T, self._result
        T.setTranslation(t)
        request.cached_gjk_guess, request.cached_support_func_guess = guess, _NO_HINT
        result.clear()
        d = pair.compute(pair.T_a, T if pair.T_b is None else T * pair.T_b, request, result)
        self.point, self.normal = result.getNearestPoint1(), result.normal.copy()
        return d

    def _resolve(self, pair: PiecePair, R: np.ndarray, t: np.ndarray, d: float) -> float:
        """The largest gap that is found, where that is not what coal says, d (NaN: nothing)."""
        close = 0.5 * self._tolerances.gjk * (1.0 + abs(d))
        starts = self._starts(pair, R, t)
        best = self._ascend_separation(pair, R, t, starts[0])

        def sure() -> bool:
            # Elsewhere there may be a larger gap.
            return bool(best.closed and (abs(d - best.gap) <= close or (math.isnan(d) and best.gap > 0.0)))

        if d <= _TOUCHING and not sure():
            self._query_pieces(pair, t, self._fine, _NO_GUESS)
            if self._has_normal():
                starts.insert(1, self.normal)
        for k in range(1, len(starts) + len(_AXES)):
            if sure():
                break
            u = starts[k] if k < len(starts) else _normalized(best.normal + _ASIDE * _AXES[k - len(starts)])
            found = self._ascend_separation(pair, R, t, u)
            if found.gap > best.gap:
                best = found
        if not best.answered or (math.isnan(d) and not best.closed):
            return math.nan
        self.point, self.normal = best.point, best.normal
        return best.gap

    def _starts(self, pair: PiecePair, R: np.ndarray, t: np.ndarray) -> list[np.ndarray]:
        """Directions to begin with: coal's normal, across two capsules, the line between the centres, and the axes."""
        across, m = pair.across(R), pair.between(R, t)
        starts = [self.normal] if self._has_normal() else []
        starts += [_normalized(u) for u in (across, m) if _square(u) > _NOTHING**2]
        return [*starts, *_AXES]

    def _ascend_separation(self, pair: PiecePair, R: np.ndarray, t: np.ndarray, u: np.ndarray) -> _Ascent:
        """Follow the normal from the direction u to where the gap grows no more."""
        found = _Ascent(pair.gap(R, t, u), u, np.zeros(3), closed=False, answered=False)
        for apart in _APART:
            for _ in range(_ROUNDS):
                u, move = found.normal, apart - found.gap
                d = self._query_pieces(pair, t + move * u, self._tight, -apart * u)
                if not (0.0 < d < _WILD):
                    break
                found.point, found.answered = self.point, True
                found.closed = abs(d - move - found.gap) <= _SURE
                n = self.normal
                gap = pair.gap(R, t, n)
                if found.gap > 1.0:
                    # Far apart, a small turn moves much: it is the way to the line between the points that counts.
                    turn = _normalized(d * n - move * u) - u
                    for step in _STEPS:
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
    """A request that starts from the guesses it holds, which every query overwrites with its own."""
    request = coal.DistanceRequest()
    request.gjk_tolerance = gjk_tolerance
    request.epa_tolerance = epa_tolerance
    request.epa_max_iterations = _EPA_ITERATIONS
    request.gjk_initial_guess = coal.GJKInitialGuess.CachedGuess
    return request
