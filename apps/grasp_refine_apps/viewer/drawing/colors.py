"""Colours of signed distances: warm inside, green at the surface, cool outside."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float, UInt8

Color = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""

COLOR_STOPS_MM: tuple[tuple[float, Color], ...] = (
    (-5.0, (170, 20, 72)),
    (-1.0, (222, 70, 30)),
    (-0.3, (240, 130, 30)),
    (-0.1, (40, 190, 100)),
    (0.1, (40, 190, 100)),
    (0.3, (60, 150, 240)),
    (1.0, (50, 105, 225)),
    (3.0, (60, 75, 210)),
    (10.0, (125, 80, 205)),
)
"""Signed distances in mm, and their colours; between them they are mixed.

All are visible on white and on black; colour-blind viewers can distinguish inside, touching and outside, too.
"""

UNKNOWN_COLOR: Color = (140, 140, 140)
"""Colour of an unknown distance."""

LEGEND_MM = ((-5.0, "5 mm inside"), (-1.0, "1 mm inside"), (0.0, "touching"), (0.3, "0.3 mm off"), (3.0, "3 mm off"))
"""Distances in mm and texts of the legend."""


def tinted(own: Color, color: Color) -> Color:
    """Return a colour tinted with another one."""
    red, green, blue = ((2 * a + 3 * b) // 5 for a, b in zip(own, color, strict=True))
    return red, green, blue


def distance_colors(distance: Float[np.ndarray, " K"]) -> UInt8[np.ndarray, "K 3"]:
    """Colours (K, 3) of signed distances (K,) in metres, negative inside; grey where one is NaN."""
    millimetres = 1e3 * np.asarray(distance, dtype=np.float64)
    known = np.isfinite(millimetres)
    stops = [stop for stop, _ in COLOR_STOPS_MM]
    channels = [
        np.interp(np.where(known, millimetres, 0.0), stops, [color[channel] for _, color in COLOR_STOPS_MM])
        for channel in range(3)
    ]
    return np.where(known[:, None], np.stack(channels, axis=-1).round(), UNKNOWN_COLOR).astype(np.uint8)


def distance_legend() -> list[tuple[str, Color]]:
    """Return the legend: texts and colours, from deepest inside to farthest off."""
    colors = distance_colors(1e-3 * np.array([distance for distance, _ in LEGEND_MM]))
    return [(text, (int(r), int(g), int(b))) for (_, text), (r, g, b) in zip(LEGEND_MM, colors, strict=True)]
