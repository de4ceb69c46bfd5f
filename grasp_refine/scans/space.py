"""Space: the seen surface, free and unknown space of a scan."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.scans.scan import Plane, Scan

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

REACH = 1.5
"""Largest angle from a line of sight to the nearest seen point, in distances to that point's fourth neighbour."""

GRAZING = 0.2
"""Smallest cosine between a line of sight and a normal for which the tangent plane gives the distance."""


@dataclass(frozen=True, eq=False)
class Space:
    """Space of a scan: free before the seen surface, beside the silhouette and below the table; unknown behind."""

    scan: Scan
    """Seen points."""
    table: Plane | None = None
    """Plane on which the object stands; its normal points to the object."""

    def free_depth(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Depth (n,) of points (n, 3) in free space in metres; negative in unknown space, -inf without a sensor.

        The depth is measured along the line of sight to the seen surface, or across it to the silhouette; below the
        table to its plane. Of several views the one with the largest depth counts.
        """
        depth = np.full(len(points), -np.inf)
        for view in self._views:
            np.maximum(depth, view.free_depth(points), out=depth)
        if self.table is not None:
            np.maximum(depth, (self.table[0] - points) @ self.table[1], out=depth)
        return depth

    @cached_property
    def margin(self) -> float:
        """Depth in metres up to which a point in free space may be on the surface: noise and distance of the points."""
        spacing = [np.median(view.reach[: len(view.ranges)] * view.ranges) for view in self._views]
        return self.scan.noise_m + float(np.mean(spacing or [0.0]))

    @cached_property
    def _views(self) -> tuple[_View, ...]:
        scan = self.scan
        seen = [scan.view == index for index in range(len(scan.origins))]
        return tuple(
            _View.of(origin, scan.points[mask], scan.normals[mask])
            for origin, mask in zip(scan.origins, seen, strict=True)
            if mask.sum() > 4
        )


@dataclass(frozen=True, eq=False)
class _View:
    """Points that one sensor saw, by their directions."""

    origin: np.ndarray
    tree: cKDTree
    """Unit directions (P, 3)."""
    ranges: np.ndarray
    """Distances (P,) from the sensor, metres."""
    offsets: np.ndarray
    """Inner products (P,) of points, seen from the sensor, and normals, metres."""
    normals: np.ndarray
    """Unit normals (P, 3)."""
    reach: np.ndarray
    """Angles (P,) up to which a line of sight meets the surface at the point."""

    @classmethod
    def of(cls, origin: np.ndarray, points: np.ndarray, normals: np.ndarray) -> _View:
        from scipy.spatial import cKDTree

        rays = points - origin
        ranges = np.linalg.norm(rays, axis=1)
        directions = rays / ranges[:, None]
        tree = cKDTree(directions)
        spacing = tree.query(directions, k=[5])[0][:, 0]
        reach = REACH * np.minimum(spacing, 2.0 * np.median(spacing))
        return cls(origin, tree, ranges, np.einsum("pi,pi->p", rays, normals), normals, reach)

    def free_depth(self, points: np.ndarray) -> np.ndarray:
        rays = points - self.origin
        distance = np.maximum(np.linalg.norm(rays, axis=1), np.finfo(float).tiny)
        directions = rays / distance[:, None]
        gap, nearest = self.tree.query(directions)
        reach, ranges = self.reach[nearest], self.ranges[nearest]
        slope = np.einsum("ni,ni->n", directions, self.normals[nearest])
        plane = self.offsets[nearest] / np.minimum(slope, -GRAZING)
        bend = reach * ranges / GRAZING
        surface = np.where(slope < -GRAZING, np.clip(plane, ranges - bend, ranges + bend), ranges)
        beside = (gap - reach) * distance
        return np.where(beside > 0.0, beside, surface - distance)
