"""Camera pose, and projection of points into its picture."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float

FIELD_OF_VIEW = 30.0
"""Vertical field of view of the camera in degrees."""


@dataclass(frozen=True, eq=False)
class View:
    """Pose of the camera; the world's z axis points up in its pictures."""

    azimuth: float
    """Horizontal direction of view, degrees from the x axis, counterclockwise seen from above."""
    elevation: float
    """Elevation of the direction of view, degrees; negative: looks down from above."""
    lookat: Float[np.ndarray, " 3"]
    """Point in the middle of the picture, world frame, metres."""
    distance: float
    """Distance of that point from the camera, metres."""

    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Return the directions right, up and forward of the picture, as rows."""
        azimuth, elevation = np.radians([self.azimuth, self.elevation])
        forward = np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
        return np.stack([right, np.cross(right, forward), forward])

    def project(self, points: Float[np.ndarray, "n 3"], width: int, height: int) -> Float[np.ndarray, "n 2"]:
        """Return positions (n, 2) of points (n, 3) in a picture of that size, pixels from the upper left corner."""
        seen = (points - self.lookat) @ self.axes().T
        scale = 0.5 * height / np.tan(np.radians(FIELD_OF_VIEW / 2)) / (seen[:, 2:] + self.distance)
        return np.array([width / 2, height / 2]) + seen[:, :2] * scale * [1, -1]

    def fit(self, points: Float[np.ndarray, "n 3"], aspect: float) -> View:
        """Return the view in this direction in which points (n, 3) just fill a picture of `aspect` width / height."""
        axes = self.axes()
        seen = points @ axes.T
        middle = (seen.max(axis=0) + seen.min(axis=0)) / 2
        away = seen - middle
        # A margin of 8 % on each side.
        slope = np.tan(np.radians(FIELD_OF_VIEW / 2)) * 0.84 * np.array([aspect, 1.0])
        distance = float(np.max(np.abs(away[:, :2]) / slope - away[:, 2:]))
        return View(self.azimuth, self.elevation, middle @ axes, distance)


VIEWS = tuple(View(float(a), float(e), np.zeros(3), 1.0) for e, a in product((-30, 20), range(10, 370, 30)))
"""Candidate views; the one that shows most of hand and object is chosen."""
