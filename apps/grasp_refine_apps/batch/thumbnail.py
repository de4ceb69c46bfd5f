"""Small pictures of a hand at an object in several poses, all from the side that shows most of its fingertips."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from grasp_refine.core.array_types import Float
from grasp_refine.objects.object import Object
from grasp_refine_apps.report.drawing import INK, best_side, photograph, write
from grasp_refine_apps.report.rasterizer import Camera, Model
from grasp_refine_apps.report.skeleton import Skeleton, object_model

WIDTH, HEIGHT = 300, 260
"""Width and height of a picture, pixels."""
OVERSAMPLING = 1.5
"""Factor by which a picture is drawn larger, then averaged for smooth edges."""
NUM_COLORS = 128
"""Number of colours of a picture; the palette halves the size of its file."""
OBJECT_OPACITY = 0.72
"""Opacity of the object; a little of the fingers behind and inside it shows through."""
VISIBLE_RADIUS = 2.3
"""Radius of the visible region about the middle of the fingertips, in distances of the farthest fingertip."""


def thumbnail(
    skeleton: Skeleton, obj: Object, T_world_root: Float[np.ndarray, "N 4 4"], q: Float[np.ndarray, "N n"]
) -> list[bytes]:
    """Draw a PNG of the hand at the object in each of N poses; the last decides the side.

    Args:
        skeleton: Surfaces of the hand.
        obj: The object, at the world's origin.
        T_world_root: Poses (N, 4, 4) of the hand's base link, world frame.
        q: Joint values (N, n).

    Raises:
        ValueError: a pose is not finite.
    """
    if not np.isfinite(T_world_root).all() or not np.isfinite(q).all():
        raise ValueError("its pose is not finite")
    solid, hands = (
        object_model(obj, OBJECT_OPACITY),
        [skeleton.posed(*pose) for pose in zip(T_world_root, q, strict=True)],
    )
    tips = _tips(hands[-1], skeleton)
    points = _interest(hands, skeleton, obj)
    # A model hides models behind it, also in a group of its own.
    side = best_side([tips, [*hands[-1], solid]], points, WIDTH / HEIGHT)
    camera = Camera.fitted(side, points, int(OVERSAMPLING * WIDTH), int(OVERSAMPLING * HEIGHT))
    return [_png(photograph([*hand, solid], camera), camera) for hand in hands]


def _tips(hand: Sequence[Model], skeleton: Skeleton) -> list[Model]:
    """Return the surfaces of the contact links; of all, where there are none."""
    return [model for model, touches in zip(hand, skeleton.touching, strict=True) if touches] or list(hand)


def _interest(hands: Sequence[Sequence[Model]], skeleton: Skeleton, obj: Object) -> Float[np.ndarray, "N 3"]:
    """Return the points (N, 3) of hand and object near the fingertips, in all poses."""
    near = np.concatenate([model.vertices for hand in hands for model in _tips(hand, skeleton)])
    middle = (near.min(0) + near.max(0)) / 2
    size = np.linalg.norm(near - middle, axis=1).max()
    points = np.concatenate([obj.body.candidates.points, *(model.vertices for hand in hands for model in hand)])
    return points[np.linalg.norm(points - middle, axis=1) < VISIBLE_RADIUS * size]


def _png(photo: Image.Image, camera: Camera) -> bytes:
    """Encode a picture as PNG, with a scale bar of 1, 2 or 5 times a power of ten in the lower left corner."""
    s, pixels_per_metre = OVERSAMPLING, camera.height / camera.extent
    length = 10.0 ** np.floor(np.log10(0.25 * camera.width / pixels_per_metre))
    length *= max(k for k in (1, 2, 5) if k * length * pixels_per_metre <= 0.25 * camera.width)
    x, y, stop = 10 * s, camera.height - 10 * s, 10 * s + length * pixels_per_metre
    draw = ImageDraw.Draw(photo)
    draw.line([x, y, stop, y], fill=INK, width=round(2 * s))
    write(draw, ((x + stop) / 2, y - 3 * s), f"{1e3 * length:g} mm", 11 * s, anchor="md")
    out = io.BytesIO()
    small = photo.resize((WIDTH, HEIGHT), Image.Resampling.HAMMING)
    small.quantize(NUM_COLORS, dither=Image.Dither.NONE).save(out, format="PNG", optimize=True)
    return out.getvalue()
