"""Small pictures of a hand at an object in several poses, all from one side: that which shows most of its fingertips.

Convex pieces are drawn with fewer corners than they have, which at this size is not to be seen and bounds the time.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float

from grasp_refine.core.errors import MeshError
from grasp_refine.core.se3 import transform_points
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece, hull
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.kinematics import Kinematics
from grasp_refine.objects.object import Object
from grasp_refine_apps.authoring.picture import BACKGROUND, CONTACT_COLOR, INK, LINK_COLOR, OBJECT_COLOR
from grasp_refine_apps.report.rasterizer import Camera, Model, render

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

WIDTH, HEIGHT = 300, 260
"""Pixels of a picture."""
OVERSAMPLING = 1.5
"""Everything is drawn this many times larger and averaged, for smooth edges."""
COLORS = 128
"""Colours of a picture, which halve the size of its file."""
SHADOW_SIZE = 300
"""Pixels along each side of the shadow map."""
EXTENT = 0.2
"""Metres that a picture is high after scaling; the rasterizer's outlines and shadows are made for this size."""
OPACITY = 0.72
"""The object lets through a little of the fingers behind it and inside it."""
CREASE = 35.0
"""Edges sharper than this (degrees) are shown as edges."""
MOST_FACES = 4000
"""Most triangles of an object that is drawn by its mesh; of a finer one, the convex pieces are drawn."""
GRID = 0.012
"""Corners of a convex piece nearer to each other than this share of the whole size are drawn as one."""
SEEN = 2.3
"""What is farther from the middle of the fingertips than so many times the farthest of them need not be seen."""
MARGIN = 1.08
"""How much larger than what is to be seen the picture is."""
NEAR = 0.08
"""In the look for a side, a point hides what lies farther behind it than this share of the farthest fingertip's way."""
LIGHT = (0.5, 0.35)
"""The light comes from the camera, moved this far (in units of the way to it) to the right and up."""
TILTS, TURNS = (0.35, -0.1, 0.8), 12
"""Sides that are tried: angles above the object's horizon (radians), and how many around it."""


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a hand is."""

    T_world_root: Float[np.ndarray, "4 4"]
    """Pose of its base link."""
    q: Float[np.ndarray, " n"]
    """Joint values."""


@dataclass(frozen=True, eq=False)
class Skeleton:
    """What is drawn of a hand, link by link, in link frames."""

    kinematics: Kinematics
    """Poses of the links that have geometry."""
    models: tuple[Model, ...]
    """Their surfaces."""
    points: tuple[Float[np.ndarray, "N 3"], ...]
    """Points on them, metres."""
    touching: tuple[bool, ...]
    """Which of them are meant to touch."""

    def posed(self, pose: Pose) -> Float[np.ndarray, "L 4 4"]:
        """Poses of the links."""
        T, q = torch.as_tensor(pose.T_world_root)[None], torch.as_tensor(pose.q)[None]
        return self.kinematics(T, q)[0].numpy()


@dataclass(frozen=True, eq=False)
class View:
    """From where, and what is seen, before it is scaled to the size that the rasterizer is made for."""

    middle: Float[np.ndarray, " 3"]
    """What lies in the middle of the picture, metres."""
    scale: float
    """By what lengths are multiplied."""
    camera: Camera
    """Of the scaled scene, about its origin."""

    def of(self, model: Model, T: Float[np.ndarray, "4 4"]) -> Model:
        """A surface as the camera meets it, without the faces that it sees from behind."""
        vertices = self.scale * (transform_points(T, model.vertices) - self.middle)
        a, b, c = vertices[model.faces].transpose(1, 0, 2)
        seen = np.cross(b - a, c - a) @ self.camera.axes[2] < 0
        return Model(vertices, model.normals @ T[:3, :3].T, model.faces[seen], model.color)


def skeleton(hand: Hand) -> Skeleton:
    """What is drawn of a hand."""
    links = [link for link in hand.links if link.body is not None]
    kinematics = Kinematics(hand, [link.name for link in links])
    points = tuple(link.solid.candidates.points for link in links)
    resting = kinematics(torch.eye(4, dtype=torch.float64)[None], torch.as_tensor(hand.rest)[None])[0].numpy()
    posed = np.concatenate([transform_points(T, its) for T, its in zip(resting, points, strict=True)])
    grid = GRID * np.ptp(posed, axis=0).max()
    touching = tuple(link.name in {contact.link for contact in hand.contacts} for link in links)
    models = (
        _pieces(link.solid, CONTACT_COLOR if touches else LINK_COLOR, grid)
        for link, touches in zip(links, touching, strict=True)
    )
    return Skeleton(kinematics, tuple(models), points, touching)


def thumbnail(skeleton: Skeleton, obj: Object, poses: Sequence[Pose]) -> list[bytes]:
    """A PNG of the hand at the object in each pose; the last one decides from which side.

    Raises:
        ValueError: a pose is not finite.
    """
    if not all(np.isfinite(pose.T_world_root).all() and np.isfinite(pose.q).all() for pose in poses):
        raise ValueError("its pose is not finite")
    links = [skeleton.posed(pose) for pose in poses]
    view = _view(skeleton, obj, links)
    solid = view.of(_surface(obj), np.eye(4))
    return [
        _png(_photo([view.of(m, T) for m, T in zip(skeleton.models, its, strict=True)], solid, view.camera), view.scale)
        for its in links
    ]


def _surface(obj: Object) -> Model:
    """What is drawn of an object."""
    if len(obj.mesh.faces) <= MOST_FACES:
        return Model.of(obj.mesh, OBJECT_COLOR, crease=CREASE)
    return _pieces(obj.body, OBJECT_COLOR, GRID * obj.body.diagonal)


def _pieces(body: Body, color: tuple[float, float, float], grid: float) -> Model:
    """The convex pieces of a body, with one corner where there are several within `grid` metres."""
    import trimesh

    whole = trimesh.util.concatenate([_simpler(piece, grid).mesh() for piece in body.pieces])
    assert isinstance(whole, trimesh.Trimesh)
    return Model.of(whole, color, crease=CREASE)


def _simpler(piece: Piece, grid: float) -> Piece:
    """A convex piece with fewer corners."""
    corners = np.asarray(piece.mesh().vertices)
    _, first = np.unique(np.round((corners - corners.mean(0)) / grid), axis=0, return_index=True)
    try:
        return hull(corners[np.sort(first)])
    except MeshError:
        # A thin one has lost its thickness.
        return piece


def _view(skeleton: Skeleton, obj: Object, links: Sequence[np.ndarray]) -> View:
    """From where the hand is seen best: most of the points of links that should touch, in the last pose."""
    posed = [[transform_points(T, p) for T, p in zip(its, skeleton.points, strict=True)] for its in links]
    hand = np.concatenate([points for its in posed for points in its])
    of_object = obj.body.candidates.points
    touches = [p for its in posed for p, t in zip(its, skeleton.touching, strict=True) if t]
    tips = np.concatenate(touches) if touches else hand
    middle = (tips.min(0) + tips.max(0)) / 2
    size = np.linalg.norm(tips - middle, axis=1).max()
    interest = np.concatenate([hand, of_object])
    interest = interest[np.linalg.norm(interest - middle, axis=1) < SEEN * size]
    points = np.concatenate([*posed[-1], of_object])
    wanted = np.concatenate([np.full(len(p), t) for p, t in zip(posed[-1], skeleton.touching, strict=True)])
    wanted = np.concatenate([wanted, np.zeros(len(of_object), dtype=bool)])
    tilt, turn = (grid.ravel() for grid in np.meshgrid(TILTS, 2 * np.pi * np.arange(TURNS) / TURNS, indexing="ij"))
    directions = np.stack([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)], axis=1)
    seen = [_seen(points, wanted, direction, NEAR * size) for direction in directions]
    # Rounding keeps the choice the same where sides are alike.
    direction = directions[np.round(seen - 0.05 * np.arange(len(seen)) / len(seen), 3).argmax()]
    flat = Camera(direction, np.zeros(3), WIDTH, HEIGHT, 1.0, perspective=False)
    at = interest @ flat.axes.T
    low, high = at.min(0), at.max(0)
    middle = (low + high) / 2 @ flat.axes
    height = MARGIN * max(high[1] - low[1], (high[0] - low[0]) * HEIGHT / WIDTH)
    scale = EXTENT / height
    far = scale * max(np.linalg.norm(hand - middle, axis=1).max(), np.linalg.norm(of_object - middle, axis=1).max())
    pixels = int(OVERSAMPLING * WIDTH), int(OVERSAMPLING * HEIGHT)
    return View(middle, scale, Camera(2.0 * far * direction, np.zeros(3), *pixels, EXTENT, perspective=False))


def _seen(points: np.ndarray, wanted: np.ndarray, direction: np.ndarray, near: float) -> float:
    """Share of the `wanted` points (N,) that no other point (N, 3) hides from this direction (3,)."""
    if not wanted.any():
        return 0.0
    axes = Camera(direction, np.zeros(3), 1, 1, 1.0, perspective=False).axes
    x, y, depth = axes @ points.T
    column, row = (np.round(at / near).astype(int) for at in (x, y))
    column, row = column - column.min(), row - row.min()
    key = column * (row.max() + 1) + row
    nearest = np.full(key.max() + 1, np.inf)
    np.minimum.at(nearest, key, depth)
    return float((depth[wanted] < nearest[key[wanted]] + near).mean())


def _photo(hand: list[Model], obj: Model, camera: Camera) -> Float[np.ndarray, "H W 3"]:
    """Hand and slightly transparent object before the background; red, green, blue in [0, 1]."""
    right, down, forward = camera.axes
    light = LIGHT[0] * right - LIGHT[1] * down - forward
    image = OPACITY * render([*hand, obj], camera, light, SHADOW_SIZE)
    image += (1.0 - OPACITY) * render(hand, camera, light, SHADOW_SIZE)
    # Where there is nothing the picture is black, so that the background can be added.
    return image[..., :3] + np.array(BACKGROUND) * (1.0 - image[..., 3:])


def _png(photo: np.ndarray, scale: float) -> bytes:
    """A picture as a file, with a bar that tells its scale."""
    from PIL import Image, ImageDraw

    image = Image.fromarray((255 * photo).round().astype(np.uint8))
    _bar(ImageDraw.Draw(image), scale * HEIGHT / EXTENT)
    small = image.resize((WIDTH, HEIGHT), Image.Resampling.HAMMING)
    out = io.BytesIO()
    small.quantize(COLORS, dither=Image.Dither.NONE).save(out, format="PNG", optimize=True)
    return out.getvalue()


def _bar(draw: ImageDraw, pixels_per_metre: float) -> None:
    """Draw a bar of 1, 2 or 5 times a power of ten in the lower left corner."""
    from PIL import ImageFont

    s, most = OVERSAMPLING, 0.25 * WIDTH
    length = 10.0 ** np.floor(np.log10(most / pixels_per_metre))
    length *= max(k for k in (1, 2, 5) if k * length * pixels_per_metre <= most)
    x, y = 10 * s, (HEIGHT - 10) * s
    stop = x + length * pixels_per_metre * s
    draw.line([x, y, stop, y], fill=INK, width=round(2 * s))
    font = ImageFont.load_default(11 * s)
    halo = tuple((255 * np.array(BACKGROUND)).round().astype(int))
    draw.text(
        ((x + stop) / 2, y - 3 * s),
        f"{1e3 * length:g} mm",
        INK,
        font,
        "md",
        stroke_width=round(3 * s),
        stroke_fill=halo,
    )
