"""Overlap of two convex polytopes that are pushed slightly into each other, and its projection along the push.

The projection is convex. Eliminating the height from a half-space that bounds the overlap from above and one that
bounds it from below gives a half-plane of the projection. Its point nearest to a goal has at most two active
half-planes. They are found by adding the half-plane that the present point violates most, until none is violated (an
LP-type problem: Sharir and Welzl 1992). This is clipping by the relevant half-planes only.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from grasp_refine.core.se3 import matvec

_VERTICAL_TOLERANCE = 1e-5
"""Largest sine of the angle between a vertical face's normal and the plane across the push; the error is at most 1e-5
epsilon."""

_VIOLATION_RATIO = 1e-6
"""Smallest violation of a half-space that is added, as a fraction of epsilon."""

_MAX_HALF_PLANES = 64
"""Most half-planes that are added."""


@dataclass(frozen=True, eq=False)
class Overlap:
    """K overlaps of two polytopes a and b: all (p, z) with m . p + c z <= o for F half-spaces, a's first.

    p are coordinates across the push, about the goal; z is the height along it. The overlaps are epsilon deep.
    """

    m: np.ndarray
    """Normals across the push (K, F, 2)."""
    c: np.ndarray
    """Normals along the push (K, F)."""
    o: np.ndarray
    """Offsets (K, F), in metres."""
    of_a: int
    """Number of half-spaces of polytope a."""
    epsilon: float
    """Depth in metres, to which the tolerances are relative."""

    def nearest(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Point p (K, 2) of each projection nearest to 0, and the heights (K,) of the top of a and the bottom of b.

        p is NaN where rounding leaves no overlap.
        """
        p = self._project()
        height = self._height(self._slack(p))
        of_a = np.arange(self.c.shape[1]) < self.of_a
        top = np.where(self._upper & of_a, height, np.inf).min(axis=1)
        bottom = np.where(self._lower & ~of_a, height, -np.inf).max(axis=1)
        return p, top, bottom

    def _project(self) -> np.ndarray:
        """Point (K, 2) of each projection nearest to 0; NaN where there is none."""
        K = len(self.c)
        answer, item, here = np.full((K, 2), np.nan), np.arange(K), self
        p, active = np.zeros((K, 2)), np.tile([0.0, 0.0, np.inf], (K, 2, 1))
        for _ in range(_MAX_HALF_PLANES):
            added, violated = here._most_violated(p)
            answer[item[~violated]] = p[~violated]
            p, active = _nearest_of_three(np.concatenate([active, added], axis=1), _VIOLATION_RATIO * self.epsilon)
            left = np.flatnonzero(violated & np.isfinite(p[:, 0]))
            if not len(left):
                break
            item, here, p, active = item[left], here._take(left), p[left], active[left]
        return answer

    def _most_violated(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The half-plane (K, 1, 3) that p (K, 2) violates most, and the mask (K,) of points that violate any."""
        slack = self._slack(p)
        height = self._height(slack)
        top = np.where(self._upper, height, np.inf)
        bottom = np.where(self._lower, height, -np.inf)
        left = np.where(self._steep, slack, np.inf)
        row = np.arange(len(p))
        upper, lower, steep = top.argmin(axis=1), bottom.argmax(axis=1), left.argmin(axis=1)
        tight = _VIOLATION_RATIO * self.epsilon
        crossed, beyond = bottom[row, lower] - top[row, upper] > tight, -left[row, steep]
        with np.errstate(divide="ignore", invalid="ignore"):
            # z <= (o - m . p) / c from above and >= from below; multiplied out, because c may be small.
            weights = np.stack([-self.c[row, lower], self.c[row, upper]], axis=1)[..., None]
            pair = (weights * np.stack([self._planes(row, upper), self._planes(row, lower)], axis=1)).sum(axis=1)
            pair /= np.hypot(pair[:, 0], pair[:, 1])[:, None]
            outside = np.where(crossed, (pair[:, :2] * p).sum(axis=1) - pair[:, 2], -np.inf)
        at_wall = (beyond > tight) & ~(outside > beyond)
        added = np.where(at_wall[:, None], self._planes(row, steep), pair)
        return added[:, None], crossed | at_wall

    def _planes(self, row: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Rows (m, o) (K, 3) of half-spaces."""
        return np.concatenate([self.m[row, which], self.o[row, which, None]], axis=1)

    def _slack(self, p: np.ndarray) -> np.ndarray:
        """Upper bounds (K, F) of c z at p (K, 2)."""
        return self.o - matvec(self.m, p)

    def _height(self, slack: np.ndarray) -> np.ndarray:
        """Heights z (K, F) of the planes; meaningless for steep planes."""
        return slack / np.where(self._steep, 1.0, self.c)

    @cached_property
    def _upper(self) -> np.ndarray:
        return self.c > _VERTICAL_TOLERANCE

    @cached_property
    def _lower(self) -> np.ndarray:
        return self.c < -_VERTICAL_TOLERANCE

    @cached_property
    def _steep(self) -> np.ndarray:
        return ~(self._upper | self._lower)

    def _take(self, index: np.ndarray) -> "Overlap":
        return self if len(index) == len(self.c) else replace(self, m=self.m[index], c=self.c[index], o=self.o[index])


def _nearest_of_three(planes: np.ndarray, tight: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (K, 2) nearest to 0 with the last of three half-planes active, and their two active planes.

    Half-planes (a, b) with |a| = 1 denote a . p <= b (K, 3, 3); (0, inf) is none. NaN where their intersection is
    empty.
    """
    a, b = planes[..., :2], planes[..., 2]
    added, others = a[:, 2:], a[:, :2]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        determinant = others[..., 0] * added[..., 1] - others[..., 1] * added[..., 0]
        x = b[:, :2] * added[..., 1] - b[:, 2:] * others[..., 1]
        y = b[:, 2:] * others[..., 0] - b[:, :2] * added[..., 0]
        corners = np.stack([x, y], axis=2) / determinant[..., None]
        points = np.concatenate([corners, added * b[:, 2:, None]], axis=1)
        fits = (points @ a.mT <= b[:, None] + tight).all(axis=2)
        squared = np.where(fits, (points**2).sum(axis=2), np.inf)
    row, best = np.arange(len(planes)), squared.argmin(axis=1)
    point = np.where(fits[row, best, None], points[row, best], np.nan)
    other = np.where((best < 2)[:, None], planes[row, best], [0.0, 0.0, np.inf])
    return point, np.stack([other, planes[:, 2]], axis=1)
