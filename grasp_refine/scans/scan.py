"""Scan: points on the part of an object's surface that sensors saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float, Int


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
