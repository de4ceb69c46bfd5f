"""Scan: points on the part of an object's surface that sensors saw."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Plane = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]
"""A point of a plane, metres, and its unit normal."""

NEAR_M = 2e-3
"""Least distance in metres from a point of a scan within which surface counts as seen."""


@dataclass(frozen=True, eq=False)
class Scan:
    """Points on the seen part of an object's surface, expressed in the frame of the object (that of the grasps)."""

    points: Float[np.ndarray, "P 3"]
    """Points, metres."""
    normals: Float[np.ndarray, "P 3"]
    """Unit normals, out of the object."""
    origins: Float[np.ndarray, "V 3"]
    """Optical centres of the sensors, metres; none: the sensors are not known, and no space is known to be free."""
    view: Int[np.ndarray, " P"]
    """Index of the sensor in `origins` that saw each point; 0 without sensors."""
    noise_m: float
    """Standard deviation of the points along the lines of sight, metres."""
    table: Plane | None = None
    """Plane on which the object stands, that was seen around it; its normal points to the object. None: not seen."""

    def seen(self, points: Float[np.ndarray, "*N 3"]) -> Bool[np.ndarray, "*N"]:
        """Return True for points of a surface (..., 3), object frame, that lie where the scan has points.

        NaN is not seen. Surface within twice the distance of neighbouring points counts, or three standard deviations
        of the noise, and at least `NEAR_M`.
        """
        known = np.isfinite(points).all(axis=-1)
        distance, _ = self._tree.query(np.where(known[..., None], points, 0.0), workers=1)
        return known & (distance <= self._spacing)

    @cached_property
    def _tree(self) -> cKDTree:
        from scipy.spatial import cKDTree

        return cKDTree(self.points)

    @cached_property
    def _spacing(self) -> float:
        """Distance in metres from a point within which surface counts as seen."""
        if len(self.points) < 2:
            return NEAR_M
        nearest = self._tree.query(self.points, k=2, workers=1)[0][:, 1]
        return max(2.0 * float(np.median(nearest)), 3.0 * self.noise_m, NEAR_M)
