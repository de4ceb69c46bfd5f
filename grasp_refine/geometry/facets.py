"""Flat faces of bodies: polygons in one plane, over all convex pieces whose surface lies in it.

A cut of the decomposition does not end a face. Curved surfaces have none, however finely they are meshed: a surface
whose radius of curvature is below `MIN_WIDTH_M`^2 / (8 `FLATNESS_M`) = 0.6 m leaves the plane within the least width.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.se3 import tangents
from grasp_refine.geometry.pieces import Piece

FLATNESS_M = 2e-5
"""Largest distance in metres of a face's vertices from its plane."""

MIN_WIDTH_M = 1e-2
"""Least width in metres of a face across its narrowest direction: more than the triangles of scans have."""

_MIN_AREA = 0.5 * MIN_WIDTH_M**2
"""Least area in square metres: a triangle of the least width has 0.577 of its square, other polygons have more."""

_BLOCK_PLANES = 256
"""Planes that are compared with all vertices at a time."""

AREA_TOLERANCE = 1e-3
"""Largest relative difference of the areas of polygons and of their hull at which the hull stands for them."""


@dataclass(frozen=True, eq=False)
class Facets:
    """F flat faces of a body, each the union of convex polygons, in the body's frame."""

    normal: Float[np.ndarray, "F 3"]
    """Outward unit normals (F, 3)."""
    offset: Float[np.ndarray, " F"]
    """Offsets (F,) of the planes n . x = offset, in metres."""
    first_polygon: Int[np.ndarray, " _"]
    """First polygon of each face, then the number Q of polygons."""
    first_vertex: Int[np.ndarray, " _"]
    """First vertex of each polygon, then the number V of vertices."""
    vertices: Float[np.ndarray, "V 3"]
    """Vertices (V, 3) in the plane of their face, counter-clockwise seen from outside, in metres."""

    def __len__(self) -> int:
        """Return the number of faces."""
        return len(self.offset)

    def polygons(self, face: int) -> list[Float[np.ndarray, "W 3"]]:
        """Convex polygons of a face."""
        numbers = range(self.first_polygon[face], self.first_polygon[face + 1])
        return [self.vertices[self.first_vertex[q] : self.first_vertex[q + 1]] for q in numbers]

    def transformed(self, T: Float[np.ndarray, "4 4"]) -> Facets:
        """The faces moved by the rigid transform `T` (4, 4), which maps their present frame to the new one."""
        normal = self.normal @ T[:3, :3].T
        vertices = self.vertices @ T[:3, :3].T + T[:3, 3]
        return replace(self, normal=normal, offset=self.offset + normal @ T[:3, 3], vertices=vertices)

    @staticmethod
    def of(pieces: Sequence[Piece]) -> Facets:
        """Find the exposed flat faces of the union of convex pieces, by the plane of their largest triangle."""
        solid = [piece for piece in pieces if len(piece.faces)]
        planes, faces = [(np.zeros((0, 3)), np.zeros(0))], []
        if solid:
            surface = _Surface.of(solid)
            left = surface.is_solid
            for k in surface.candidates():
                n, offset = surface.normal[k], surface.offset[k]
                if not left[k]:
                    continue
                polygons = _polygons(surface.ends(n, offset), n)
                exposed = [polygon for polygon in polygons if not _is_covered(polygon, n, solid)]
                if polygons:
                    left = left & ~surface.lie_in(n, offset)
                if exposed:
                    planes.append((n[None], np.array([offset])))
                    faces.append(exposed)
        normal, offset = (np.concatenate(part) for part in zip(*planes, strict=True))
        polygons = [polygon for face in faces for polygon in face]
        return Facets(
            normal,
            offset,
            np.cumsum([0, *map(len, faces)]),
            np.cumsum([0, *map(len, polygons)]),
            np.concatenate([np.zeros((0, 3)), *polygons]),
        )


@dataclass(frozen=True, eq=False)
class _Surface:
    """Triangles of convex pieces."""

    vertices: np.ndarray
    """Vertices (V, 3) of all pieces."""
    radius: np.ndarray
    """Radius (V,) of the piece of each vertex."""
    start: np.ndarray
    """First vertex (P,) of each piece."""
    faces: np.ndarray
    """Triangles (T, 3)."""
    area: np.ndarray
    """Areas (T,)."""
    normal: np.ndarray
    """Normals (T, 3)."""
    offset: np.ndarray
    """Offsets (T,) of their planes."""
    is_solid: np.ndarray
    """Mask (T,) of the triangles that have a normal."""

    @staticmethod
    def of(pieces: Sequence[Piece]) -> _Surface:
        vertices = np.concatenate([piece.vertices for piece in pieces])
        count = [len(piece.vertices) for piece in pieces]
        start = np.cumsum([0, *count[:-1]])
        radius = np.repeat([piece.radius for piece in pieces], count)
        faces = np.concatenate([piece.faces + first for piece, first in zip(pieces, start, strict=True)])
        area, normal = (np.concatenate([getattr(piece, name) for piece in pieces]) for name in ("areas", "normals"))
        offset = (normal * vertices[faces[:, 0]]).sum(axis=1) + radius[faces[:, 0]]
        return _Surface(vertices, radius, start, faces, area, normal, offset, np.any(normal, axis=1))

    def candidates(self) -> np.ndarray:
        """Triangles whose planes hold enough area for a face, large ones first."""
        order = np.argsort(-self.area, kind="stable")
        order = order[self.is_solid[order]]
        enough = [order[:0]]
        for block in np.split(order, range(_BLOCK_PLANES, len(order), _BLOCK_PLANES)):
            height = self.vertices @ self.normal[block].T + self.radius[:, None] - self.offset[block]
            flat = np.abs(height) <= FLATNESS_M
            area = self.area @ flat[self.faces].all(axis=1)
            enough.append(block[area >= _MIN_AREA])
        return np.concatenate(enough)

    def height(self, n: np.ndarray, offset: float) -> np.ndarray:
        """Heights (V,) of the surface above a plane."""
        return self.vertices @ n + self.radius - offset

    def ends(self, n: np.ndarray, offset: float) -> list[np.ndarray]:
        """Points (W, 3) in the plane of each piece that ends in it."""
        height = self.height(n, offset)
        flat = np.abs(height) <= FLATNESS_M
        ends = np.maximum.reduceat(height, self.start) <= FLATNESS_M
        found = []
        for k in np.flatnonzero(ends & (np.add.reduceat(flat.astype(np.int64), self.start) > 2)):
            end = self.start[k + 1] if k + 1 < len(self.start) else len(height)
            here = np.flatnonzero(flat[self.start[k] : end]) + self.start[k]
            found.append(self.vertices[here] + (self.radius[here] - height[here])[:, None] * n)
        return found

    def lie_in(self, n: np.ndarray, offset: float) -> np.ndarray:
        """Mask (T,) of the triangles that lie in a plane and face the same way."""
        flat = np.abs(self.height(n, offset)) <= FLATNESS_M
        return flat[self.faces].all(axis=1) & (self.normal @ n > 0.9)


def _is_covered(polygon: np.ndarray, n: np.ndarray, pieces: Sequence[Piece]) -> bool:
    """Whether pieces cover a polygon, as at a cut: at its middle, and halfway from there to its corners."""
    middle = polygon.mean(axis=0)
    points = np.concatenate([middle[None], 0.5 * (polygon + middle)]) + 5.0 * FLATNESS_M * n
    covered = np.zeros(len(points), dtype=bool)
    for piece in pieces:
        normals, offsets = piece.planes
        covered |= (points @ normals.T <= offsets + piece.radius).all(axis=1)
    return bool(covered.all())


def _polygons(parts: Sequence[np.ndarray], n: np.ndarray) -> list[np.ndarray]:
    """Convex polygons of the points of each piece in a plane; one where they make up their hull; none if too narrow."""
    if not parts:
        return []
    E, everything = tangents(n), np.concatenate(parts)
    E = E if np.linalg.det(np.column_stack([E, n])) > 0 else E[:, ::-1]
    whole = everything[convex_polygon(everything @ E)]
    if width(whole @ E) < MIN_WIDTH_M:
        return []
    hulls = [part[convex_polygon(part @ E)] for part in parts]
    hulls = [hull for hull in hulls if len(hull) > 2]
    area, total = polygon_area(whole @ E), sum(polygon_area(hull @ E) for hull in hulls)
    return [whole] if abs(total - area) <= AREA_TOLERANCE * area else hulls


def convex_polygon(points: Float[np.ndarray, "V 2"]) -> Int[np.ndarray, " W"]:
    """Indices (W,) of the convex hull vertices of points (V, 2), counter-clockwise, without vertices on edges."""
    order = np.lexsort(points.T[::-1])
    tight = 1e-9 * max(float(np.ptp(points, axis=0).max()), 1e-300)

    def chain(indices: np.ndarray) -> list[int]:
        found: list[int] = []
        for i in indices.tolist():
            while len(found) > 1:
                edge, ahead = points[found[-1]] - points[found[-2]], points[i] - points[found[-2]]
                if edge[0] * ahead[1] - edge[1] * ahead[0] > tight * np.hypot(*ahead):
                    break
                found.pop()
            found.append(i)
        return found[:-1]

    return np.array([*chain(order), *chain(order[::-1])], dtype=np.int64)


def polygon_area(corners: Float[np.ndarray, "V 2"]) -> float:
    """Area of a polygon, positive where its corners are counter-clockwise."""
    x, y = corners.T
    return 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def width(corners: Float[np.ndarray, "V 2"]) -> float:
    """Least width of a convex polygon."""
    if len(corners) < 3:
        return 0.0
    edge = np.roll(corners, -1, axis=0) - corners
    across = np.stack([-edge[:, 1], edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1)[:, None]
    return float(np.ptp(across @ corners.T, axis=1).min())
