"""Patches where flat faces of links meet flat faces of an object at rest: their corners, gaps and motion.

There the witness point is not determined: it jumps from corner to corner as the link turns by 1e-9 rad. A patch is the
overlap of the two faces, projected onto the object's, over all convex pieces that lie in them; it is given by the
at most four corners that lie farthest apart. It moves continuously, corners and gaps have exact derivatives, and forces
at its corners make all torques that the faces can transmit (Caron, Pham, Nakamura 2015, for rectangles of a foot).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, radians
from typing import Any

import numpy as np

from grasp_refine.collision.engine import chosen
from grasp_refine.collision.query import Witness
from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.profiling import count_patches
from grasp_refine.core.se3 import hat, tangents
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.facets import Facets

NUM_CORNERS = 4
"""Largest number of corners of a patch."""

MAX_TILT_RAD = radians(20.0)
"""Largest angle between two faces that meet, and between a face and the contact normal."""

FULL_TILT_RAD = radians(12.0)
"""Angle between two faces up to which a patch counts in full (`FacePatches.weight`)."""

NEAR_PLANE_M = 2e-4
"""Largest distance in metres of a witness point from the plane of its face."""

MIN_EXTENT_M = 2e-3
"""Least distance in metres of the farthest two corners of a patch; one of twice that counts in full."""

SEGMENT_WIDTH_M = 5e-4
"""Width in metres below which a patch is a segment."""

_PARALLEL_SINE = 1e-6
"""Sine of the angle between edges that count as parallel."""

_TIE, _SLIVER = 1e-6, 1e-3
"""Relative difference of distances that are taken as equal; least height of a corner above a line, relatively."""


@dataclass(frozen=True, eq=False)
class FacePatches:
    """Patches of contacts of any shape (...), world frame."""

    count: Int[np.ndarray, ...]
    """Number of corners (...): 0, 2 (a segment), 3 or 4."""
    normal: Float[np.ndarray, "... 3"]
    """Normals (..., 3) of the object's faces into the object."""
    weight: Float[np.ndarray, ...]
    """Weights (...): 1, falling to 0 as faces tilt apart and as patches shrink."""
    point: Float[np.ndarray, "... 4 3"]
    """Corners (..., 4, 3) on the object, counter-clockwise seen from outside it, in metres; 0 where there are fewer."""
    gap: Float[np.ndarray, "... 4"]
    """Signed distances (..., 4) of the link's face from them along the normal, in metres; 0 where there are fewer."""
    motion: Float[np.ndarray, "... 4 3 6"]
    """Derivatives (..., 4, 3, 6) of the corners in the link's twist; exact while the same edges meet."""
    slope: Float[np.ndarray, "... 4 6"]
    """Derivatives (..., 4, 6) of the gaps in the link's twist, likewise."""

    @property
    def there(self) -> Bool[np.ndarray, "... 4"]:
        """Mask (..., 4) of the corners that exist."""
        return np.arange(NUM_CORNERS) < self.count[..., None]


@dataclass(frozen=True, eq=False)
class FacePairs:
    """Flat faces of L links and of K objects."""

    links: tuple[Facets, ...]
    """Faces of the links, link frames."""
    objects: tuple[Facets, ...]
    """Faces of the objects, their own frames."""

    @staticmethod
    def of(links: Sequence[Body], objects: Sequence[Body]) -> FacePairs:
        """Find the faces of bodies."""
        faces = tuple(each.facets for each in objects)
        # A link has none to find where no object has any.
        return FacePairs(tuple(link.facets if any(map(len, faces)) else Facets.of(()) for link in links), faces)

    @staticmethod
    def none(links: int, objects: int) -> FacePairs:
        """Return no faces, for a number of links and of objects."""
        nothing = Facets.of(())
        return FacePairs((nothing,) * links, (nothing,) * objects)

    @cached_property
    def derived(self) -> dict[str, Any]:
        """Structures that the compiled engine built from the faces."""
        return {}

    @cached_property
    def flat(self) -> Bool[np.ndarray, "K L"]:
        """Mask (K, L) of the links that can meet an object face to face: a certificate for the others."""
        links, objects = (np.array([len(each) > 0 for each in side], dtype=bool) for side in (self.links, self.objects))
        return objects[:, None] & links

    def patches(
        self,
        link: Int[np.ndarray, ...],
        number: Int[np.ndarray, ...],
        T_world_link: Float[np.ndarray, "... 4 4"],
        witness: Witness,
        needed: Bool[np.ndarray, ...],
    ) -> FacePatches:
        """Patches of links and objects, which rest at the world's origin, about witness points (...).

        Args:
            link: Index of each contact's link.
            number: Index of each contact's object.
            T_world_link: Poses of the links.
            witness: Witness points of the links (a) and the objects (b).
            needed: Mask of the contacts; others have no patch.
        """
        shape = needed.shape
        items = np.flatnonzero((needed & witness.valid & self.flat[number, link]).reshape(-1))
        count_patches(len(items))
        M = len(items)
        link, number = link.reshape(-1)[items], number.reshape(-1)[items]
        T = T_world_link.reshape(-1, 4, 4)[items]
        of = witness.reshape(-1).rows(items)
        found = _Found.none(M)
        if chosen("auto") == "native":
            from grasp_refine.witness.native_patch import find_patches, tables

            if not self.derived:
                self.derived["native"] = (*tables(self.links), *tables(self.objects))
            limits = cos(MAX_TILT_RAD), NEAR_PLANE_M, MIN_EXTENT_M, SEGMENT_WIDTH_M
            find_patches(self.derived["native"], limits, link, number, T, of, tuple(vars(found).values()))
        else:
            for i in range(M):
                faces = self.links[link[i]].transformed(T[i])
                _find(faces, self.objects[number[i]], of.point_a[i], of.point_b[i], of.normal[i], found, i)
        tilt = (found.cosine - cos(MAX_TILT_RAD)) / (cos(FULL_TILT_RAD) - cos(MAX_TILT_RAD))
        weight = np.clip(tilt, 0.0, 1.0) * np.clip(found.extent / MIN_EXTENT_M - 1.0, 0.0, 1.0)
        fields = found.count, -found.normal, weight, found.point, found.gap, found.motion, found.slope

        def spread(values: np.ndarray) -> np.ndarray:
            everywhere = np.zeros((int(np.prod(shape)), *values.shape[1:]), dtype=values.dtype)
            everywhere[items] = values
            return everywhere.reshape(*shape, *values.shape[1:])

        return FacePatches(*(spread(values) for values in fields))


@dataclass(frozen=True, eq=False)
class _Found:
    """Arrays of M patches that are filled in."""

    count: np.ndarray
    normal: np.ndarray
    """Outward normals of the object's faces."""
    cosine: np.ndarray
    """Cosines of the angles between the faces."""
    extent: np.ndarray
    """Distances of the farthest two corners."""
    point: np.ndarray
    gap: np.ndarray
    motion: np.ndarray
    slope: np.ndarray

    @staticmethod
    def none(M: int) -> _Found:
        shapes = (3,), (), (), (4, 3), (4,), (4, 3, 6), (4, 6)
        return _Found(np.zeros(M, dtype=np.int64), *(np.zeros((M, *shape)) for shape in shapes))


def _find(
    link: Facets, obj: Facets, x_link: np.ndarray, x_object: np.ndarray, n: np.ndarray, found: _Found, i: int
) -> None:
    """Fill in patch i, as `collision/native/face_patch.h`; the link's faces are in the world frame."""
    least = cos(MAX_TILT_RAD)

    def candidates(faces: Facets, x: np.ndarray, direction: np.ndarray) -> np.ndarray:
        near = np.abs(faces.normal @ x - faces.offset) <= NEAR_PLANE_M
        return np.flatnonzero((faces.normal @ direction > least) & near)

    of_link, of_object = candidates(link, x_link, n), candidates(obj, x_object, -n)
    if not (len(of_link) and len(of_object)):
        return
    cosines = -link.normal[of_link] @ obj.normal[of_object].T
    if not cosines.max() > least:
        return
    f, g = (
        int(row[k])
        for row, k in zip((of_link, of_object), np.unravel_index(cosines.argmax(), cosines.shape), strict=True)
    )
    n_a, n_b = link.normal[f], obj.normal[g]
    E, origin = tangents(n_b), x_object + (obj.offset[g] - n_b @ x_object) * n_b
    corners: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for polygon in link.polygons(f):
        # Seen along the object's normal, the link's polygon is clockwise.
        shape = _edges((polygon[::-1] - origin) @ E, of_link=True)
        for other in obj.polygons(g):
            clipped = shape
            for at, outward, _ in _edges((other - origin) @ E, of_link=False):
                clipped = _clip(clipped, at, outward)
            for last, edge in zip([*clipped[-1:], *clipped[:-1]], clipped, strict=True):
                corners.append((edge[0], np.stack([last[1], edge[1]]), np.array([last[2], edge[2]])))
    extent, chosen_corners = _choose(np.array([corner[0] for corner in corners]).reshape(-1, 2))
    found.count[i], found.normal[i] = len(chosen_corners), n_b
    found.cosine[i], found.extent[i] = cosines.max(), extent
    along = n_a @ n_b
    for k, number in enumerate(chosen_corners):
        at, across, moves = corners[number]
        x = origin + E @ at
        gap = (link.offset[f] - n_a @ x) / along
        velocity = np.concatenate([np.eye(3), -hat(x + gap * n_b)], axis=1)
        slide = E.T @ velocity
        if abs(np.linalg.det(across)) > _PARALLEL_SINE:
            du = np.linalg.solve(across, np.where(moves[:, None], across @ slide, 0.0))
        else:
            du = slide * bool(moves.any())
        found.point[i, k], found.gap[i, k], found.motion[i, k] = x, gap, E @ du
        found.slope[i, k] = (n_a @ velocity - n_a @ E @ du) / along


_Edge = tuple[np.ndarray, np.ndarray, bool]
"""Corner of a polygon, outward normal of the edge that follows, and whether that is an edge of the link."""


def _edges(polygon: np.ndarray, *, of_link: bool) -> list[_Edge]:
    edge = np.roll(polygon, -1, axis=0) - polygon
    across = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1)[:, None]
    return [(at, outward, of_link) for at, outward in zip(polygon, across, strict=True)]


def _clip(polygon: list[_Edge], at: np.ndarray, outward: np.ndarray) -> list[_Edge]:
    """Part of a polygon inside an edge through a point."""
    clipped: list[_Edge] = []
    side = [float(outward @ (edge[0] - at)) for edge in polygon]
    for k, edge in enumerate(polygon):
        after = (k + 1) % len(polygon)
        inside, stays = side[k] <= 0, side[after] <= 0
        if inside:
            clipped.append(edge)
        if inside != stays:
            share = side[k] / (side[k] - side[after])
            crossing = edge[0] + share * (polygon[after][0] - edge[0])
            clipped.append((crossing, outward, False) if inside else (crossing, *edge[1:]))
    return clipped


def _choose(points: np.ndarray) -> tuple[float, list[int]]:
    """Extent, and at most four corners: the farthest two, and the farthest on both sides of the line between them."""
    if len(points) < 2:
        return 0.0, []
    i = j = 0
    most = 0.0
    for p in range(len(points)):
        for q in range(p + 1, len(points)):
            squared = float(((points[p] - points[q]) ** 2).sum())
            if squared > most * (1 + _TIE):
                most, i, j = squared, p, q
    extent = float(np.sqrt(most))
    if not extent >= MIN_EXTENT_M:
        return extent, []
    line = (points[j] - points[i]) / extent
    left, right, above, below = i, i, 0.0, 0.0
    for p, (x, y) in enumerate(points - points[i]):
        height = float(line[0] * y - line[1] * x)
        if height > above + _TIE * extent:
            above, left = height, p
        if height < below - _TIE * extent:
            below, right = height, p
    wide = max(above, -below) >= SEGMENT_WIDTH_M
    lower = [right] if wide and -below > _SLIVER * extent else []
    upper = [left] if wide and above > _SLIVER * extent else []
    return extent, [i, *lower, j, *upper]
