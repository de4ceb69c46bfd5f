"""Look of our pictures: colours, light, lettering, and the side from which most is seen."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image, ImageFont

from grasp_refine.core.array_types import Float
from grasp_refine_apps.report.rasterizer import Camera, Model, count_owners, render

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

BACKGROUND = (0.976, 0.98, 0.988)
OBJECT_COLOR, LINK_COLOR, CONTACT_COLOR = (0.66, 0.78, 0.93), (0.74, 0.76, 0.80), (0.95, 0.72, 0.40)
INK, GREY, BAD, GOOD = "#1b2430", "#5b6675", "#c62828", "#1b8a3a"
"""Colours of text, of lesser text, of failure, and of success."""
LIGHT_OFFSET = (0.5, 0.35)
"""Offsets of the light from the camera to the right and up, in units of the camera's distance."""
SIDES = tuple(
    np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)])
    for tilt in (0.35, -0.1, 0.8)
    for turn in 2 * np.pi * np.arange(12) / 12
)
"""Candidate directions (3,) towards the camera, preferred ones first: a little above the horizon, below it, above."""
SIDE_PX = 64
"""Height of the pictures in which sides are compared, pixels."""


def photograph(models: Sequence[Model], camera: Camera, light: np.ndarray | None = None) -> Image.Image:
    """Render models on the background, lit from beside the camera or from the direction `light` (3,)."""
    right, down, forward = camera.axes
    if light is None:
        light = LIGHT_OFFSET[0] * right - LIGHT_OFFSET[1] * down - forward
    image = render(models, camera, light)
    photo = image[..., :3] + np.array(BACKGROUND) * (1.0 - image[..., 3:])
    return Image.fromarray((255 * photo).round().astype(np.uint8))


def best_side(
    groups: Sequence[Sequence[Model]],
    points: Float[np.ndarray, "N 3"],
    aspect: float,
    push: np.ndarray | None = None,
    above: bool = False,
) -> Float[np.ndarray, " 3"]:
    """Return the direction (3,) of `SIDES` from which most of each group of models is seen.

    Args:
        groups: Groups of models that should be seen, all equally; the last one only hides others.
        points: Points (N, 3) that the picture will show, metres.
        aspect: Its width / height.
        push: Direction (3,) that should lie in the picture; None: there is none.
        above: Whether only sides above the horizon are candidates, as there is a table.
    """
    ends = np.cumsum([len(models) for models in groups])
    models = [model for models in groups for model in models]

    def score(number: int) -> float:
        camera = Camera.fitted(SIDES[number], points, round(SIDE_PX * aspect), SIDE_PX)
        # Of two small parts more is seen than of one that is as large.
        parts = np.sqrt(count_owners(models, camera) / (SIDE_PX**2 * aspect))
        share = float(np.prod([each.sum() for each in np.split(parts, ends[:-1])[:-1]]))
        across = 1.0 if push is None else float(np.linalg.norm(np.cross(push, SIDES[number])))
        # Rounding keeps the choice the same where sides are alike.
        return round(share * (0.2 + 0.8 * across**2) * (1.0 - 0.05 * number / len(SIDES)), 3)

    return SIDES[max((i for i, side in enumerate(SIDES) if side[2] > 0 or not above), key=score)]


def font(size: float, text: str = "", width: float = np.inf) -> ImageFont.FreeTypeFont:
    """Return the font of a size in pixels, or a smaller one in which `text` is not wider than `width` pixels."""
    found = ImageFont.load_default(size)
    length = found.getlength(text)
    if length > width:
        found = ImageFont.load_default(max(size * width / length, 6.0))
    assert isinstance(found, ImageFont.FreeTypeFont)
    return found


def write(
    draw: ImageDraw, place: tuple[float, float], text: str, size: float, color: str = INK, anchor: str = "la"
) -> None:
    """Write text of a size in pixels at a place, with a halo in the colour of the background."""
    halo = tuple((255 * np.array(BACKGROUND)).round().astype(int))
    draw.text(place, text, color, font(size), anchor, stroke_width=max(round(size / 8), 1), stroke_fill=halo)
