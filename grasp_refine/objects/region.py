"""Regions of an object: where hands should touch it, or should not, each with a signed distance in its frame."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.short_repr import brief

if TYPE_CHECKING:
    from scipy.spatial import KDTree

ON_SURFACE_M = 1e-6
"""Distance in metres from a face below which its direction is rounding, and counts as none."""

EDGE_SHARE = 0.025
"""Longest edge, as a share of the diagonal, of the triangles that stand for faces in the search for the nearest."""

NUM_NEAREST = 8
"""Triangles with the nearest centres, among which the nearest one is searched."""


@dataclass(frozen=True, eq=False)
class Region(ABC):
    """A part of space, or of the surface of an object."""

    spec: str
    """Its specification, for messages."""

    __repr__ = brief

    @abstractmethod
    def signed_distance(
        self, points: Float[np.ndarray, "*batch 3"]
    ) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch 3"]]:
        """Return the signed distances (...) of points (..., 3), negative inside, and their gradients (..., 3).

        Args:
            points: Points near the surface of the object, its frame, metres.
        """


@dataclass(frozen=True, eq=False, repr=False)
class Box(Region):
    """A box along the axes of the object's frame."""

    low: Float[np.ndarray, " 3"]
    """Lower corner (3,), metres."""
    high: Float[np.ndarray, " 3"]
    """Upper corner (3,), metres."""

    def signed_distance(
        self, points: Float[np.ndarray, "*batch 3"]
    ) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch 3"]]:
        """Return the distance outside; inside minus that of the nearest side."""
        away = np.maximum(self.low - points, points - self.high)
        side = np.where(self.low - points > points - self.high, -1.0, 1.0)
        beyond = np.maximum(away, 0.0)
        outside = np.sqrt((beyond * beyond).sum(axis=-1))
        nearest = np.eye(3)[away.argmax(axis=-1)]
        direction = np.where((outside > 0)[..., None], beyond / np.where(outside > 0, outside, 1.0)[..., None], nearest)
        return outside + np.minimum(away.max(axis=-1), 0.0), side * direction


@dataclass(frozen=True, eq=False, repr=False)
class HalfSpace(Region):
    """One side of a plane: points p with n . p >= offset."""

    normal: Float[np.ndarray, " 3"]
    """Unit normal n (3,) towards the region."""
    offset: float
    """Offset in metres."""

    def signed_distance(
        self, points: Float[np.ndarray, "*batch 3"]
    ) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch 3"]]:
        """Return offset - n . p and -n."""
        return self.offset - points @ self.normal, np.broadcast_to(-self.normal, points.shape)


@dataclass(frozen=True, eq=False, repr=False)
class Faces(Region):
    """Some of the faces of a mesh.

    The signed distance is that from these faces minus that from all others. On the mesh one of the two is 0, and it is
    the distance, through space, from the border; near it, as on the convex pieces of an object, it is continuous.
    """

    triangles: Float[np.ndarray, "F 3 3"]
    """Corners (F, 3, 3) of all triangles of the mesh, object frame, metres."""
    chosen: Bool[np.ndarray, " F"]
    """True for the faces (F,) of the region."""

    def signed_distance(
        self, points: Float[np.ndarray, "*batch 3"]
    ) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch 3"]]:
        """Return the distance from the faces minus that from the others; -inf where there are no others."""
        flat = points.reshape(-1, 3)
        (own, towards), (other, away) = (part.distance(flat) for part in self._parts)
        return (own - other).reshape(points.shape[:-1]), (towards - away).reshape(points.shape)

    @cached_property
    def _parts(self) -> tuple[_Triangles, _Triangles]:
        edge = EDGE_SHARE * float(np.linalg.norm(np.ptp(self.triangles.reshape(-1, 3), axis=0)))
        return _Triangles.of(self.triangles[self.chosen], edge), _Triangles.of(self.triangles[~self.chosen], edge)


@dataclass(frozen=True, eq=False)
class _Triangles:
    """Triangles of about one size, and a tree of their centres."""

    corners: Float[np.ndarray, "T 3 3"]
    tree: KDTree | None

    @staticmethod
    def of(triangles: Float[np.ndarray, "F 3 3"], edge: float) -> _Triangles:
        """Return triangles, subdivided where an edge is longer than `edge` metres."""
        from scipy.spatial import KDTree
        from trimesh.remesh import subdivide_to_size

        area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
        triangles = triangles[area > 0.0]
        if not len(triangles):
            return _Triangles(triangles, None)
        corners = triangles.reshape(-1, 3)
        vertices, faces = subdivide_to_size(corners, np.arange(len(corners)).reshape(-1, 3), edge, max_iter=40)
        cut = np.asarray(vertices)[np.asarray(faces)]
        return _Triangles(cut, KDTree(cut.mean(axis=1)))

    def distance(self, points: Float[np.ndarray, "P 3"]) -> tuple[Float[np.ndarray, " P"], Float[np.ndarray, "P 3"]]:
        """Return the distances (P,) of points from the nearest triangle, inf without any, and unit vectors from it.

        They are 0 within `ON_SURFACE_M`. Far away, where it may not be among the faces with the nearest centres, the
        distance is up to half an edge too large.
        """
        from trimesh.triangles import closest_point

        if self.tree is None:
            return np.full(len(points), np.inf), np.zeros(points.shape)
        known = np.isfinite(points).all(axis=1)
        points = np.where(known[:, None], points, 0.0)
        count = min(NUM_NEAREST, len(self.corners))
        _, near = self.tree.query(points, k=count)
        near = near.reshape(len(points), count)
        at = closest_point(self.corners[near.ravel()], np.repeat(points, count, axis=0)).reshape(len(points), count, 3)
        apart = points[:, None] - at
        length = np.linalg.norm(apart, axis=-1)
        best = length.argmin(axis=1)[:, None]
        length, apart = np.take_along_axis(length, best, 1)[:, 0], np.take_along_axis(apart, best[..., None], 1)[:, 0]
        far = known & (length > ON_SURFACE_M)
        unit = np.where(far[:, None], apart / np.where(far, length, 1.0)[:, None], 0.0)
        return np.where(known, length, np.nan), unit


@dataclass(frozen=True, eq=False)
class ContactRegions:
    """Regions of an object in which hands touch it: in any that is wanted, if there is one, and in none to avoid."""

    touch: tuple[Region, ...] = ()
    """Regions that are wanted; none: everywhere."""
    avoid: tuple[Region, ...] = ()
    """Regions that are forbidden."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.text})"

    @property
    def text(self) -> str:
        """The specifications in words, such as "touch box:..., avoid above:z=0.08"."""
        parts = ("touch", self.touch), ("avoid", self.avoid)
        return ", ".join(f"{verb} {' or '.join(one.spec for one in regions)}" for verb, regions in parts if regions)

    def signed_distance(
        self, points: Float[np.ndarray, "*batch 3"]
    ) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch 3"]]:
        """Return how far (...) points (..., 3) are outside of where hands may touch, negative inside, and gradients.

        It is the largest of the distances from the regions to touch, of several the nearest, and of the depths in
        each that is to be avoided.

        Args:
            points: Points near the surface of the object, its frame, metres.
        """
        found = [self._wanted(points)] if self.touch else []
        for region in self.avoid:
            distance, gradient = region.signed_distance(points)
            found.append((-distance, -gradient))
        return _pick([distance for distance, _ in found], [gradient for _, gradient in found], np.argmax)

    def miss(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
        """Return the distances (...) in metres of points outside of where hands may touch; 0 inside."""
        return np.maximum(self.signed_distance(points)[0], 0.0)

    def reason(self, point: Float[np.ndarray, " 3"]) -> str:
        """Return why a hand may not touch at a point (3,), such as "3.1 mm outside of box:..."."""
        one = point[None]
        depth = [-float(region.signed_distance(one)[0][0]) for region in self.avoid]
        outside = float(self._wanted(one)[0][0]) if self.touch else -np.inf
        if depth and max(depth) >= outside:
            return f"{1e3 * max(depth):.1f} mm inside of {self.avoid[int(np.argmax(depth))].spec}, which it must avoid"
        return f"{1e3 * outside:.1f} mm outside of {' and '.join(region.spec for region in self.touch)}"

    def _wanted(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = [region.signed_distance(points) for region in self.touch]
        return _pick([distance for distance, _ in found], [gradient for _, gradient in found], np.argmin)


def _pick(
    distances: list[np.ndarray], gradients: list[np.ndarray], which: Callable[..., Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Return one distance (...) and its gradient (..., 3) for each point, by `np.argmin` or `np.argmax`."""
    if len(distances) == 1:
        return distances[0], gradients[0]
    distance, gradient = np.stack(distances), np.stack(gradients)
    at = which(distance, axis=0)[None]
    return np.take_along_axis(distance, at, 0)[0], np.take_along_axis(gradient, at[..., None], 0)[0]
