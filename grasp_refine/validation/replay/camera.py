"""Where a camera stands, and where points are in its picture."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float

FIELD_OF_VIEW = 30.0
"""Vertical opening of the camera in degrees."""


@dataclass(frozen=True, eq=False)
class View:
    """Where the camera stands; the world's z axis points up in its pictures."""

    azimuth: float
    """In which direction it looks, seen from above: degrees from the x axis, counterclockwise."""
    elevation: float
    """How steeply it looks up, degrees; negative from above."""
    lookat: Float[np.ndarray, " 3"]
    """The point in the middle of the picture, metres."""
    distance: float
    """How far that point is away, metres."""

    def axes(self) -> Float[np.ndarray, "3 3"]:
        """What is right, up and forward in the picture, as rows."""
        azimuth, elevation = np.radians([self.azimuth, self.elevation])
        forward = np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
        return np.stack([right, np.cross(right, forward), forward])

    def project(self, points: Float[np.ndarray, "n 3"], width: int, height: int) -> Float[np.ndarray, "n 2"]:
        """Where points (n, 3) are in a picture of that size (n, 2), pixels from the upper left corner."""
        seen = (points - self.lookat) @ self.axes().T
        scale = 0.5 * height / np.tan(np.radians(FIELD_OF_VIEW / 2)) / (seen[:, 2:] + self.distance)
        return np.array([width / 2, height / 2]) + seen[:, :2] * scale * [1, -1]

    def fitted(self, points: Float[np.ndarray, "n 3"], aspect: float) -> View:
        """The same direction, from where points (n, 3) just fill a picture that is `aspect` times as wide as high."""
        axes = self.axes()
        seen = points @ axes.T
        middle = (seen.max(axis=0) + seen.min(axis=0)) / 2
        away = seen - middle
        # A margin of 8 % on each side.
        slope = np.tan(np.radians(FIELD_OF_VIEW / 2)) * 0.84 * np.array([aspect, 1.0])
        distance = float(np.max(np.abs(away[:, :2]) / slope - away[:, 2:]))
        return View(self.azimuth, self.elevation, middle @ axes, distance)


VIEWS = tuple(View(float(a), float(e), np.zeros(3), 1.0) for e, a in product((-30, 20), range(10, 370, 30)))
"""From where a picture may be taken; the one that shows most of hand and object is chosen."""
