"""Reference: signed distances and witness points of convex pieces from the hull of their difference, by Qhull.

Two pieces, rotated by R, overlap at the offset t where -t lies in the polytope M = {R y - x}, x of the first piece and
y of the second. Its hull is computed once for a rotation, in units in which the bodies are about 1 long (a power of
two, so that scaling is exact). Then all offsets are points p = -t, and with outward unit normals n_f of M

    inside:  d = max_f (n_f . p - offset_f),  the nearest facet,
    outside: d = the distance to the nearest triangle.

Both are direct and share no code with the engines; the error is some 1e-15 of the size. Radii are
subtracted. Where both pieces are points or segments, M is only a point, a segment or a parallelogram.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import product

import numpy as np

from grasp_refine.geometry.pieces import Piece
from grasp_refine_apps.bench.stability.polytopes import (
    FACE_TOLERANCE,
    crossing,
    is_point,
    on_triangles,
    supporting,
    surface,
)

_MIN_CROSSING_SINE = 0.05
"""Smallest sine of the angle of two edges whose crossing defines the points."""

_MAX_SLIDE = 1e4
"""Points that slide farther than this for each metre of distance are not unique."""

_TIE_TOLERANCE = 1e-5
"""Nearest facets whose depths differ by less (as a share of the size) are ties."""

_POINTS = ("point_a", "point_b")

_MAX_ENTRIES = 1_000_000
"""Largest number of entries of a temporary matrix."""


@dataclass(frozen=True, eq=False)
class Truth:
    """Truth at N offsets, in the frame of the first piece and in metres."""

    distance: np.ndarray
    """Signed distances (N,)."""
    normal: np.ndarray
    """Unit normals (N, 3) from the first to the second; not unique where pieces touch or overlap."""
    point_a: np.ndarray
    """Witness points (N, 3) on the first piece; meaningful where `unique`."""
    point_b: np.ndarray
    """Witness points (N, 3) on the second piece; meaningful where `unique`."""
    unique: np.ndarray
    """True (N,) where there is one pair of witness points, which small errors of the distance move little."""
    core: np.ndarray
    """Signed distances (N,) of the cores, without their radii."""
    slide: np.ndarray
    """Largest slide (N,) of points on the pieces for each metre of error of the distance; where `unique`."""


class Difference:
    """The difference of two convex pieces at one rotation."""

    def __init__(self, a: Piece, b: Piece, R: np.ndarray) -> None:
        """Prepare the pieces `a` and `b`, the second one turned by R (3, 3) into the frame of the first."""
        self.a, self.b, self.turned = a, b, b.vertices @ R.T
        self.radii = a.radius, b.radius
        # Vertices and all differences about 1 long.
        reach = max(np.ptp(a.vertices, axis=0).max(), np.ptp(self.turned, axis=0).max(), *self.radii)
        self.unit = float(2.0 ** np.round(np.log2(reach)))
        # About the middle of each piece, the differences of coordinates keep their digits.
        self.middle = self.turned.mean(axis=0) - a.vertices.mean(axis=0)
        self.core_a = (a.vertices - a.vertices.mean(axis=0)) / self.unit
        self.core_b = (self.turned - self.turned.mean(axis=0)) / self.unit
        self.triangles, self.normals, self.offsets = surface(self.core_a, self.core_b)
        self.centers = self.triangles.mean(axis=1)
        self.spheres = np.linalg.norm(self.triangles - self.centers[:, None], axis=2).max(axis=1)

    def at(self, t: np.ndarray) -> Truth:
        """Return the truth at offsets t (N, 3): the origin of the second body in the frame of the first, in metres."""
        p = -(t + self.middle) / self.unit
        rows = max(1, _MAX_ENTRIES // len(self.centers))
        parts = [self._nearest(p[start : start + rows]) for start in range(0, len(p), rows)]
        core, q, normal, face, clear = (np.concatenate(column) for column in zip(*parts, strict=True))
        in_a, in_b, slide = self._witnesses(q, face)
        distance = core * self.unit - sum(self.radii)
        x_a = in_a * self.unit + self.a.vertices.mean(axis=0) + self.radii[0] * normal
        x_b = in_b * self.unit + self.turned.mean(axis=0) + t - self.radii[1] * normal
        return Truth(distance, normal, x_a, x_b, clear & (slide <= _MAX_SLIDE), core * self.unit, slide)

    def boundary(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Draw an offset (3,) at which the cores touch, at a facet, edge or vertex of M, and a way (3,) out of it."""
        corners = self.triangles
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        facet = rng.choice(len(area), p=area / area.sum() if area.sum() > 0 else None)
        weights = rng.dirichlet(np.ones(3)) * (rng.permutation(3) >= rng.integers(3))
        q = weights / weights.sum() @ corners[facet]
        away = rng.normal(size=3) if self.flat else -self.normals[facet]
        return -(q * self.unit) - self.middle, away

    def _nearest(self, p: np.ndarray) -> tuple[np.ndarray, ...]:
        """Find the nearest points to p (N, 3) on the surface of M.

        Returns:
            The signed distances from M (N,), the nearest points (N, 3), unit directions (N, 3) from p to them where
            p is outside and back where it is inside, inward normals (N, 3) of a face of M that they are on, and where
            (N,) no other face of another direction is as near.
        """
        heights = p @ self.normals.T - self.offsets
        facet = heights.argmax(axis=1)
        distance = heights[np.arange(len(p)), facet]
        inward = -self.normals[facet]
        q = p.copy() if self.flat else p + distance[:, None] * inward
        rivals = heights > distance[:, None] - _TIE_TOLERANCE
        cosines = np.einsum("ij,kj->ik", -inward, self.normals)
        clear = ~(rivals & (cosines < 1.0 - 1e-9)).any(axis=1)
        normal = inward.copy()
        outside = np.flatnonzero((distance > 0.0) | np.full(len(p), self.flat))
        if len(outside):
            distance[outside], q[outside] = self._to_triangles(p[outside], heights[outside])
            gap = distance[outside]
            clear[outside] = (gap > FACE_TOLERANCE) if self.flat else True
            for limit, direction in ((1e-12, normal), (FACE_TOLERANCE, inward)):
                away = outside[gap > limit]
                direction[away] = (q[away] - p[away]) / distance[away, None]
        normal[~normal.any(axis=1)] = self._across
        return distance, q, normal, inward, clear

    @property
    def _across(self) -> np.ndarray:
        """Unit vector (3,) perpendicular to M, which has no interior."""
        edges = np.append(np.diff(self.triangles[0], axis=0), np.eye(3), axis=0)
        crosses = np.cross(edges[:2, None], edges).reshape(-1, 3)
        lengths = np.linalg.norm(crosses, axis=1)
        # Two edges, or else an edge and an axis, or else any vector.
        solid = np.flatnonzero(lengths > 1e-9)
        return crosses[solid[0]] / lengths[solid[0]] if len(solid) else np.array([1.0, 0.0, 0.0])

    @property
    def flat(self) -> bool:
        """True if M has no interior."""
        return not np.isfinite(self.offsets).all()

    def _to_triangles(self, p: np.ndarray, heights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return distances (N,) of points outside from the nearest triangles, and the nearest points."""
        reach = np.linalg.norm(p[:, None] - self.centers, axis=2)
        most = (reach + self.spheres).min(axis=1, keepdims=True)
        near = np.maximum(reach - self.spheres, heights) <= most * (1 + 1e-12) + 1e-12
        if not self.flat:
            near &= heights > -1e-12
        row, triangle = np.nonzero(near)
        points = on_triangles(p[row], self.triangles[triangle])
        distance = np.linalg.norm(points - p[row], axis=1)
        order = np.lexsort((distance, row))
        first = order[np.flatnonzero(np.diff(row[order], prepend=-1))]
        return distance[first], points[first]

    def _witnesses(self, q: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return points x of the first and y of the second core with y - x = q, and their slide; infinite: not unique.

        The supporting faces along n are compared: one of them is a point, or both are edges that cross.
        """
        N = len(q)
        x, y, slide = np.zeros((N, 3)), np.zeros((N, 3)), np.full(N, np.inf)
        rows = max(1, _MAX_ENTRIES // max(len(self.core_a), len(self.core_b)))
        for start in range(0, N, rows):
            block = slice(start, start + rows)
            faces_a, slopes_a = supporting(self.core_a, n[block])
            faces_b, slopes_b = supporting(self.core_b, -n[block])
            for i, (on_a, on_b, a, b) in enumerate(zip(faces_a, faces_b, slopes_a, slopes_b, strict=True), start):
                first, second = self.core_a[on_a], self.core_b[on_b]
                # Both points slide together, so that the steeper of two tips holds them.
                if is_point(first):
                    x[i], y[i] = first[0], first[0] + q[i]
                    slide[i] = 1.0 + (min(a, b) if is_point(second) else a)
                elif is_point(second):
                    x[i], y[i], slide[i] = second[0] - q[i], second[0], 1.0 + b
                elif len(first) == len(second) == 2:
                    x[i], y[i], sine = crossing(first, second, q[i])
                    if sine > _MIN_CROSSING_SINE:
                        slide[i] = 1.0 + (a + b) / sine
        return x, y, slide


class Truths:
    """The differences of two bodies of any number of pieces: the minimum over the piece pairs."""

    def __init__(self, a: Sequence[Piece], b: Sequence[Piece], R: np.ndarray) -> None:
        """Prepare the pieces of both bodies, the second body turned by R (3, 3) into the frame of the first."""
        self.pairs = list(product(a, b))
        self.R = R
        self._differences: dict[int, Difference] = {}
        self._sides = _Side.of(a, np.eye(3)), _Side.of(b, R)
        first, second = self._sides
        self._offset = (first.centers[:, None] - second.centers).reshape(-1, 3)
        self._radius = np.add.outer(first.radii, second.radii).ravel()

    def difference(self, k: int) -> Difference:
        """Return the difference of the piece pair k, counted with the pieces of the second body fastest."""
        if k not in self._differences:
            self._differences[k] = Difference(*self.pairs[k], self.R)
        return self._differences[k]

    def at(self, t: np.ndarray) -> Truth:
        """Return the truth at offsets t (N, 3): the origin of the second body in the frame of the first, in metres."""
        if len(self.pairs) == 1:
            return self.difference(0).at(t)
        bound = np.linalg.norm(t[:, None] - self._offset, axis=2) - self._radius
        normal, point_a, point_b = np.zeros((3, len(t), 3))
        unique, (core, slide) = np.zeros(len(t), dtype=bool), np.zeros((2, len(t)))
        found = Truth(np.full(len(t), np.inf), normal, point_a, point_b, unique, core, slide)
        # The pair with the lowest bound first; then all that can still be nearer.
        first = bound.argmin(axis=1)
        for k in np.unique(first):
            self._lower(found, k, t, np.flatnonzero(first == k))
        bound = np.maximum(bound, self._apart(t, found.normal))
        bound[np.arange(len(t)), first] = np.inf
        # A rival at the same distance is evaluated, too.
        slack = _TIE_TOLERANCE * self._radius
        left = np.flatnonzero((bound < found.distance[:, None] + slack).any(axis=0))
        for k in left[np.argsort(bound[:, left].min(axis=0))]:
            self._lower(found, k, t, np.flatnonzero(bound[:, k] < found.distance + slack[k]))
        return found

    def _apart(self, t: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Distances (N, K) of all piece pairs along the unit vectors n (N, 3): lower bounds of the truth."""
        first, second = self._sides
        lowest = np.einsum("ij,ij->i", n, t)[:, None] - second.reach(-n)
        return (lowest[:, None] - first.reach(n)[:, :, None]).reshape(len(t), -1)

    def _lower(self, found: Truth, k: int, t: np.ndarray, rows: np.ndarray) -> None:
        """Replace results by the results of the piece pair k where this pair is nearer."""
        if not len(rows):
            return
        new, size = self.difference(k).at(t[rows]), self._radius[k]
        moved = np.maximum(*(np.abs(getattr(new, name) - getattr(found, name)[rows]).max(axis=1) for name in _POINTS))
        tie = (np.abs(new.distance - found.distance[rows]) < _TIE_TOLERANCE * size) & ~(moved <= FACE_TOLERANCE * size)
        better = new.distance < found.distance[rows]
        index = rows[better]
        for field in fields(Truth):
            getattr(found, field.name)[index] = getattr(new, field.name)[better]
        found.unique[rows[tie]] = False


@dataclass(frozen=True, eq=False)
class _Side:
    """The P pieces of a body."""

    vertices: np.ndarray
    """Vertices of all pieces (V, 3)."""
    starts: np.ndarray
    """Index of the first vertex of each piece (P,)."""
    swept: np.ndarray
    """Radius of each piece (P,)."""
    centers: np.ndarray
    """Centres (P, 3) of bounding spheres."""
    radii: np.ndarray
    """Radii of the bounding spheres (P,)."""

    @staticmethod
    def of(pieces: Sequence[Piece], R: np.ndarray) -> _Side:
        """Make the pieces rotated by R (3, 3)."""
        turned = [piece.vertices @ R.T for piece in pieces]
        centers = np.array([vertices.mean(axis=0) for vertices in turned])
        swept = np.array([piece.radius for piece in pieces])
        cores = [
            np.linalg.norm(vertices - center, axis=1).max() for vertices, center in zip(turned, centers, strict=True)
        ]
        starts = np.cumsum([0, *(len(vertices) for vertices in turned)])[:-1]
        return _Side(np.concatenate(turned), starts, swept, centers, np.array(cores) + swept)

    def reach(self, n: np.ndarray) -> np.ndarray:
        """Extent (N, P) of each piece along the vectors n (N, 3)."""
        return np.maximum.reduceat(n @ self.vertices.T, self.starts, axis=1) + self.swept
