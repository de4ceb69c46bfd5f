"""Small pictures of a hand at an object in several poses, all from the side that shows most of its fingertips.

Convex pieces are drawn with fewer corners than they have, which is invisible at this size and bounds the time.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from grasp_refine.core.errors import MeshError
from grasp_refine.core.se3 import transform_points
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece, hull
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine_apps.authoring.picture import BACKGROUND, CONTACT_COLOR, INK, LINK_COLOR, OBJECT_COLOR
from grasp_refine_apps.report.rasterizer import Camera, Model, render

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

WIDTH, HEIGHT = 300, 260
"""Width and height of a picture, pixels."""
OVERSAMPLING = 1.5
"""Factor by which a picture is drawn larger, then averaged for smooth edges."""
NUM_COLORS = 128
"""Number of colours of a picture; the palette halves the size of its file."""
SHADOW_SIZE = 300
"""Side of the shadow map, pixels."""
EXTENT_M = 0.2
"""Height of a picture after scaling, metres; the rasterizer's outlines and shadows are made for this size."""
OBJECT_OPACITY = 0.72
"""Opacity of the object; a little of the fingers behind and inside it shows through."""
CREASE_DEG = 35.0
"""Angle above which edges are shaded as sharp, degrees."""
MAX_FACES = 4000
"""Maximum number of triangles of an object drawn by its mesh; of a finer one, the convex pieces are drawn."""
MERGE_SHARE = 0.012
"""Share of the whole size within which corners of a convex piece are merged."""
VISIBLE_RADIUS = 2.3
"""Radius of the visible region about the middle of the fingertips, in distances of the farthest fingertip."""
MARGIN_FACTOR = 1.08
"""Size of the picture relative to the visible region."""
HIDING_DEPTH = 0.08
"""Depth behind a point from which others are hidden in the choice of a side, in distances of the farthest fingertip."""
LIGHT_OFFSET = (0.5, 0.35)
"""Offsets of the light from the camera to the right and up, in units of the camera's distance."""
TILTS_RAD, NUM_TURNS = (0.35, -0.1, 0.8), 12
"""Candidate sides: angles above the object's horizon, radians, and number of directions around it."""


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose and joint values of a hand."""

    T_world_root: Float[np.ndarray, "4 4"]
    """Pose (4, 4) of the base link, world frame."""
    q: Float[np.ndarray, " n"]
    """Joint values (n,)."""


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Drawable surfaces of a hand, link by link, in link frames."""

    chain: Chain
    """Forward kinematics of the links that have geometry."""
    models: tuple[Model, ...]
    """Surfaces of the links."""
    points: tuple[Float[np.ndarray, "N 3"], ...]
    """Surface points (N, 3) of each link, metres."""
    touching: tuple[bool, ...]
    """True for contact links."""

    def posed(self, pose: Pose) -> Float[np.ndarray, "L 4 4"]:
        """Return the poses (L, 4, 4) of the links in the world frame."""
        return self.chain(pose.T_world_root[None], pose.q[None]).T_world_link[0]


@dataclass(frozen=True, eq=False)
class View:
    """View of a scene: centre, scale to the size that the rasterizer is made for, and camera."""

    middle: Float[np.ndarray, " 3"]
    """Point (3,) in the middle of the picture, world frame, metres."""
    scale: float
    """Factor of all lengths."""
    camera: Camera
    """Camera of the scaled scene, which is centred at the origin."""

    def of(self, model: Model, T: Float[np.ndarray, "4 4"]) -> Model:
        """Transform a surface to the scaled scene, without faces that the camera sees from behind."""
        vertices = self.scale * (transform_points(T, model.vertices) - self.middle)
        a, b, c = vertices[model.faces].transpose(1, 0, 2)
        seen = np.cross(b - a, c - a) @ self.camera.axes[2] < 0
        return Model(vertices, model.normals @ T[:3, :3].T, model.faces[seen], model.color)


def skeleton(hand: Hand) -> Skeleton:
    """Return the drawable surfaces of a hand."""
    links = [link for link in hand.links if link.body is not None]
    chain = Chain(hand, [link.name for link in links])
    points = tuple(link.solid.candidates.points for link in links)
    resting = chain(np.eye(4)[None], hand.rest[None]).T_world_link[0]
    posed = np.concatenate([transform_points(T, its) for T, its in zip(resting, points, strict=True)])
    grid = MERGE_SHARE * np.ptp(posed, axis=0).max()
    touching = tuple(link.name in {contact.link for contact in hand.contacts} for link in links)
    models = (
        _pieces(link.solid, CONTACT_COLOR if touches else LINK_COLOR, grid)
        for link, touches in zip(links, touching, strict=True)
    )
    return Skeleton(chain, tuple(models), points, touching)


def thumbnail(skeleton: Skeleton, obj: Object, poses: Sequence[Pose]) -> list[bytes]:
    """Draw a PNG of the hand at the object in each pose; the last pose decides the side.

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
    """Drawable surface of an object."""
    if len(obj.mesh.faces) <= MAX_FACES:
        return Model.of(obj.mesh, OBJECT_COLOR, crease=CREASE_DEG)
    return _pieces(obj.body, OBJECT_COLOR, MERGE_SHARE * obj.body.diagonal)


def _pieces(body: Body, color: tuple[float, float, float], grid: float) -> Model:
    """Convex pieces of a body, with corners merged within `grid` metres."""
    import trimesh

    whole = trimesh.util.concatenate([_simplified(piece, grid).mesh() for piece in body.pieces])
    assert isinstance(whole, trimesh.Trimesh)
    return Model.of(whole, color, crease=CREASE_DEG)


def _simplified(piece: Piece, grid: float) -> Piece:
    """Reduce the corners of a convex piece."""
    corners = np.asarray(piece.mesh().vertices)
    _, first = np.unique(np.round((corners - corners.mean(0)) / grid), axis=0, return_index=True)
    try:
        return hull(corners[np.sort(first)])
    except MeshError:
        # A thin one has lost its thickness.
        return piece


def _view(skeleton: Skeleton, obj: Object, links: Sequence[np.ndarray]) -> View:
    """View that shows most of the points of contact links, in the last pose."""
    posed = [[transform_points(T, p) for T, p in zip(its, skeleton.points, strict=True)] for its in links]
    hand = np.concatenate([points for its in posed for points in its])
    of_object = obj.body.candidates.points
    touches = [p for its in posed for p, t in zip(its, skeleton.touching, strict=True) if t]
    tips = np.concatenate(touches) if touches else hand
    middle = (tips.min(0) + tips.max(0)) / 2
    size = np.linalg.norm(tips - middle, axis=1).max()
    interest = np.concatenate([hand, of_object])
    interest = interest[np.linalg.norm(interest - middle, axis=1) < VISIBLE_RADIUS * size]
    points = np.concatenate([*posed[-1], of_object])
    wanted = np.concatenate([np.full(len(p), t) for p, t in zip(posed[-1], skeleton.touching, strict=True)])
    wanted = np.concatenate([wanted, np.zeros(len(of_object), dtype=bool)])
    tilt, turn = (
        grid.ravel() for grid in np.meshgrid(TILTS_RAD, 2 * np.pi * np.arange(NUM_TURNS) / NUM_TURNS, indexing="ij")
    )
    directions = np.stack([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)], axis=1)
    seen = [_visible_share(points, wanted, direction, HIDING_DEPTH * size) for direction in directions]
    # Rounding keeps the choice the same where sides are alike.
    direction = directions[np.round(seen - 0.05 * np.arange(len(seen)) / len(seen), 3).argmax()]
    flat = Camera(direction, np.zeros(3), WIDTH, HEIGHT, 1.0, perspective=False)
    at = interest @ flat.axes.T
    low, high = at.min(0), at.max(0)
    middle = (low + high) / 2 @ flat.axes
    height = MARGIN_FACTOR * max(high[1] - low[1], (high[0] - low[0]) * HEIGHT / WIDTH)
    scale = EXTENT_M / height
    far = scale * max(np.linalg.norm(hand - middle, axis=1).max(), np.linalg.norm(of_object - middle, axis=1).max())
    pixels = int(OVERSAMPLING * WIDTH), int(OVERSAMPLING * HEIGHT)
    return View(middle, scale, Camera(2.0 * far * direction, np.zeros(3), *pixels, EXTENT_M, perspective=False))


def _visible_share(points: np.ndarray, wanted: np.ndarray, direction: np.ndarray, near: float) -> float:
    """Share of the masked points (N,) that no other point (N, 3) hides from this direction (3,)."""
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
    """Render the hand and the slightly transparent object on the background; red, green, blue in [0, 1]."""
    right, down, forward = camera.axes
    light = LIGHT_OFFSET[0] * right - LIGHT_OFFSET[1] * down - forward
    image = OBJECT_OPACITY * render([*hand, obj], camera, light, SHADOW_SIZE)
    image += (1.0 - OBJECT_OPACITY) * render(hand, camera, light, SHADOW_SIZE)
    # Empty pixels are black, so that the background can be added.
    return image[..., :3] + np.array(BACKGROUND) * (1.0 - image[..., 3:])


def _png(photo: np.ndarray, scale: float) -> bytes:
    """Encode a picture as PNG, with a scale bar."""
    from PIL import Image, ImageDraw

    image = Image.fromarray((255 * photo).round().astype(np.uint8))
    _bar(ImageDraw.Draw(image), scale * HEIGHT / EXTENT_M)
    small = image.resize((WIDTH, HEIGHT), Image.Resampling.HAMMING)
    out = io.BytesIO()
    small.quantize(NUM_COLORS, dither=Image.Dither.NONE).save(out, format="PNG", optimize=True)
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
