"""Typical failures: pictures of missed targets, and the facts that explain why they were missed.

In a picture body a (blue, slightly transparent) lies below and body b (orange) above: the scene is rotated so that
the contact normal points up, and is seen from the side.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float

from grasp_refine.collision.query import Pairs
from grasp_refine.core.se3 import transform_points
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece
from grasp_refine_apps.report.rasterizer import Camera, Model, render

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

Feature = Literal["vertex", "edge", "face", "round surface"]

PLANE_TOLERANCE = 1e-5
"""A witness point lies in a face if its distance to the face's plane is below this fraction of the piece's size."""
CONTACT_DISTANCE_M = 1e-5
"""Bodies closer than this (metres) are in contact, whatever the sign of their distance."""
BESIDE_DISTANCE, BESIDE_RISE = 0.03, 0.01
"""Another piece makes the place concave: largest distance and smallest rise, as fractions of the diagonal."""

WIDTH, HEIGHT = 420, 340
OVERSAMPLING = 2
"""Supersampling factor: pictures are drawn this many times larger and averaged, for smooth edges."""
PICTURE_HEIGHT_M = 0.2
"""Height of a picture in metres after scaling; the rasterizer's outlines and shadows are made for this size."""
COLOR_A, COLOR_B, BACKGROUND = (0.56, 0.72, 0.93), (0.96, 0.68, 0.36), (0.976, 0.98, 0.988)
OPACITY_A = 0.6
CREASE_ANGLE_DEG = 20.0
"""Edges sharper than this (degrees) are drawn as edges."""
INK, MARK_A, MARK_B = "#1b2430", "#0b4f9c", "#a63c00"
LIGHT_OFFSET = (0.5, 0.25)
"""Position of the light: the camera, moved this far (in units of its distance) to the right and up."""


@dataclass(frozen=True, eq=False)
class WitnessPoints:
    """The answer of one query; world frame."""

    point_a: Float[np.ndarray, " 3"]
    """Witness point on body a, metres."""
    point_b: Float[np.ndarray, " 3"]
    """Witness point on body b, metres."""
    normal: Float[np.ndarray, " 3"]
    """Unit normal from body a to body b."""
    distance: float
    """Signed distance in metres."""
    winner: int
    """Closest piece pair, an index into `Pairs.piece_pairs` of the two bodies; -1: the query failed."""


@dataclass(frozen=True, eq=False)
class Failure:
    """Final state of a task that was not solved."""

    method: str
    """Label of the variant; its first word is the derivative method."""
    kind: str
    """Kind of the bodies: "convex" or "concave"."""
    target_class: str
    """Features that the targets lie on, such as "face-vertex"."""
    body_a: Body
    """The fixed body, in its own frame."""
    body_b: Body
    """The moving body, in its own frame."""
    T_world_a: Float[np.ndarray, "4 4"]
    """Pose of body a."""
    T_world_b: Float[np.ndarray, "4 4"]
    """Pose of body b where its error was smallest."""
    target_a: Float[np.ndarray, " 3"]
    """Target of the witness point of body a, metres, body frame."""
    target_b: Float[np.ndarray, " 3"]
    """Target of the witness point of body b, metres, body frame."""
    margin: float
    """Desired signed distance in metres."""
    witness: WitnessPoints
    """Answer of a query at these poses."""

    @cached_property
    def targets(self) -> Float[np.ndarray, "2 3"]:
        """Both targets (2, 3) in the world frame, metres."""
        return np.stack(
            [transform_points(self.T_world_a, self.target_a), transform_points(self.T_world_b, self.target_b)]
        )

    @cached_property
    def points(self) -> Float[np.ndarray, "2 3"]:
        """Both witness points (2, 3) in the world frame, metres."""
        return np.stack([self.witness.point_a, self.witness.point_b])

    @property
    def misses(self) -> Float[np.ndarray, " 2"]:
        """Distance (2,) of each witness point from its target, metres."""
        return np.linalg.norm(self.points - self.targets, axis=1)

    @property
    def error(self) -> float:
        """The error in square metres that the benchmark reports."""
        return float((self.misses**2).sum() + (self.witness.distance - self.margin) ** 2)


@dataclass(frozen=True)
class Place:
    """Location of a witness point on its body."""

    feature: Feature
    """Feature of the closest piece on which it lies."""
    beside: float | None
    """Distance in metres to a piece that rises beside it; None: the body is convex there."""


def place(body: Body, piece: Piece, point: np.ndarray, normal: np.ndarray) -> Place:
    """Locate a witness point; everything in the frame of the body.

    Args:
        body: The body.
        piece: The piece of it that is closest to the other body.
        point: The witness point (3,).
        normal: Outward contact normal (3,).
    """
    beside = [
        distance
        for other in body.pieces
        if other is not piece
        and ((other.vertices - point) @ normal).max() + other.radius > BESIDE_RISE * body.diagonal
        and (distance := _distance(other, point)) < BESIDE_DISTANCE * body.diagonal
    ]
    return Place(feature(piece, point, normal), min(beside, default=None))


def feature(piece: Piece, point: np.ndarray, normal: np.ndarray) -> Feature:
    """Return the feature of a piece's surface that holds a point (3,) with outward contact normal (3,), body frame."""
    if piece.radius > 0:
        return "round surface"
    normals, offsets = piece.planes
    gaps = np.abs(normals @ point - offsets)
    size = np.linalg.norm(np.ptp(piece.vertices, axis=0))
    # Directions that no active face excludes; nearly parallel faces count as one.
    active = normals[gaps <= max(PLANE_TOLERANCE * size, 1.001 * gaps.min())]
    values = np.linalg.eigvalsh(active.T @ active)
    return ("vertex", "edge", "face")[int((values < 1e-9 * values[-1]).sum())]


def caption(failure: Failure) -> str:
    """Describe the miss, the features at the witness points, and their effect on the method."""
    w = failure.witness
    if w.winner < 0:
        return "The collision query gave no witness points at the last pose."
    a, b = _places(failure)
    if abs(w.distance) < CONTACT_DISTANCE_M:
        apart = "The bodies touch"
    elif w.distance > 0:
        apart = f"The bodies are {_mm(w.distance)} apart"
    else:
        apart = f"The bodies penetrate by {_mm(-w.distance)}"
    wanted = f" ({_mm(failure.margin)} desired)" if abs(w.distance - failure.margin) > CONTACT_DISTANCE_M else ""
    where = f"the witness point is {_on(a.feature)} of body a and {_on(b.feature)} of body b"
    if a.feature == b.feature:
        where = f"the witness points are both {_on(a.feature)}"
    misses = " and ".join(_mm(miss) for miss in failure.misses)
    said = f"{apart}{wanted}; {where}, {misses} from the targets."
    for name, its in (("a", a), ("b", b)):
        if its.beside is not None:
            gap = "touching" if its.beside < CONTACT_DISTANCE_M else f"{_mm(its.beside)} from"
            said += f" Body {name} is concave there: another piece of it rises {gap} its witness point."
    reason = _reason(failure, a, b)
    return f"{said} {reason}" if reason else said


def blind_spot(failure: Failure) -> bool:
    """True where the features at the witness points are known to blind the method."""
    return failure.witness.winner >= 0 and bool(_reason(failure, *_places(failure)))


def _reason(failure: Failure, a: Place, b: Place) -> str:
    """Explain the effect of these features on the derivative, where it is known."""
    method = failure.method.split(" ")[0]
    missed = [its for its, miss in zip((a, b), failure.misses, strict=True) if miss > 1e-4]
    features = {its.feature for its in missed}
    if method == "analytical" and "vertex" in features:
        return "At a vertex the analytical derivative is zero: it does not see that the point could move on."
    if method == "analytical" and "edge" in features:
        return "At an edge the analytical derivative sees only moves along it."
    if any(its.beside is not None for its in missed):
        return "The closest piece can change at once there, which a derivative at one point does not show."
    if method == "direction" and abs(failure.witness.distance) <= CONTACT_DISTANCE_M:
        return "Close to contact the direction between the witness points, which this method rotates, vanishes."
    if method == "direction" and "face" in features:
        return "All points of a face lie equally far along its normal, so this method cannot distinguish them."
    if method == "zeroth-order" and failure.witness.distance < -CONTACT_DISTANCE_M:
        return "In penetration the deepest points can jump between sides, which makes sampled differences noisy."
    if method == "rigid":
        return "This method treats the witness points as fixed to their bodies."
    return ""


def picture(failure: Failure) -> bytes:
    """Render a PNG of the scene: targets as rings, witness points as dots, a line from each point to its target."""
    from PIL import Image, ImageDraw

    turn = _upright(failure.witness.normal)
    interest = np.concatenate([failure.points, failure.targets])
    middle = (interest.min(0) + interest.max(0)) / 2
    reach = max(np.linalg.norm(interest - middle, axis=1).max(), 1e-4)
    smaller = min(failure.body_a.diagonal, failure.body_b.diagonal)
    scale = PICTURE_HEIGHT_M / max(2.7 * reach, 0.55 * smaller)

    def seen(points: np.ndarray) -> np.ndarray:
        return scale * (points - middle) @ turn.T

    marks = seen(interest)
    pieces = [
        (transform_points(T, piece.vertices), piece)
        for body, T in ((failure.body_a, failure.T_world_a), (failure.body_b, failure.T_world_b))
        for piece in body.pieces
    ]
    far = max(np.linalg.norm(seen(vertices), axis=1).max() + scale * piece.radius for vertices, piece in pieces)
    direction = _viewpoint(failure, turn, interest, marks)
    size = OVERSAMPLING * np.array([WIDTH, HEIGHT])
    target = (marks.min(0) + marks.max(0)) / 2
    camera = Camera(
        target + 2.0 * far * direction, target, int(size[0]), int(size[1]), PICTURE_HEIGHT_M, perspective=False
    )
    a = _model(failure.body_a, failure.T_world_a, seen, COLOR_A)
    b = _model(failure.body_b, failure.T_world_b, seen, COLOR_B)
    photo = OPACITY_A * _on_background([a, b], camera) + (1.0 - OPACITY_A) * _on_background([b], camera)
    image = Image.fromarray((255 * photo).round().astype(np.uint8))
    _annotate(ImageDraw.Draw(image), camera.project(marks)[:, :2], scale * HEIGHT / PICTURE_HEIGHT_M)
    out = io.BytesIO()
    image.resize((WIDTH, HEIGHT), Image.Resampling.BOX).save(out, format="PNG", optimize=True)
    return out.getvalue()


def _places(failure: Failure) -> list[Place]:
    """Locate both witness points."""
    w = failure.witness
    sides = Pairs((failure.body_a,), (failure.body_b,)).piece_pairs
    found = []
    for body, T, pieces, point, normal in (
        (failure.body_a, failure.T_world_a, sides[0], w.point_a, w.normal),
        (failure.body_b, failure.T_world_b, sides[1], w.point_b, -w.normal),
    ):
        R, p = T[:3, :3], T[:3, 3]
        found.append(place(body, pieces[w.winner], R.T @ (point - p), R.T @ normal))
    return found


def _distance(piece: Piece, point: np.ndarray) -> float:
    """Distance in metres from a point (3,) to a piece, 0 inside it."""
    import trimesh

    if len(piece.vertices) <= 2:
        start, stop = piece.vertices[0], piece.vertices[-1]
        along = stop - start
        t = np.clip((point - start) @ along / max(along @ along, 1e-30), 0.0, 1.0)
        closest = start + t * along
    else:
        normals, offsets = piece.planes
        if (normals @ point <= offsets).all():
            return 0.0
        corners = piece.vertices[piece.faces]
        each = trimesh.triangles.closest_point(corners, np.broadcast_to(point, (len(corners), 3)))
        closest = each[np.linalg.norm(each - point, axis=1).argmin()]
    return max(float(np.linalg.norm(point - closest)) - piece.radius, 0.0)


def _upright(normal: np.ndarray) -> Float[np.ndarray, "3 3"]:
    """Rotation that turns `normal` (3,) to z."""
    z = normal / np.linalg.norm(normal) if np.linalg.norm(normal) > 0 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _viewpoint(failure: Failure, turn: np.ndarray, interest: np.ndarray, marks: np.ndarray) -> np.ndarray:
    """Direction (3,) from the scene to the camera, z up: perpendicular to the normal, with the best view of all marks.

    Args:
        failure: The scene.
        turn: Rotation (3, 3) from the world to the picture's frame.
        interest: Witness points and targets (4, 3), world frame.
        marks: Witness points and targets (4, 3), the picture's frame.
    """
    tilt, angle = (grid.ravel() for grid in np.meshgrid((0.12, 0.4, -0.25), np.arange(24) * np.pi / 12))
    directions = np.stack([np.cos(tilt) * np.cos(angle), np.cos(tilt) * np.sin(angle), np.sin(tilt)], axis=1)
    right = np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)])
    width = np.ptp(marks @ right, axis=0) / (np.ptp(marks, axis=0).max() + 1e-12)
    hidden = sum(_hidden(failure, point, directions @ turn) for point in interest)
    # Rounding makes the choice stable where views are alike.
    return directions[np.round(0.5 * width - hidden - 0.3 * np.abs(tilt), 6).argmax()]


def _hidden(failure: Failure, point: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Occlusion (D,) of a point (3,) seen from directions (D, 3), world: 1 by body b, less by the transparent a."""
    cover = np.zeros(len(directions))
    for body, T, weight in ((failure.body_a, failure.T_world_a, 0.6), (failure.body_b, failure.T_world_b, 1.0)):
        p, u = T[:3, :3].T @ (point - T[:3, 3]), directions @ T[:3, :3]
        start = 5e-3 * body.diagonal
        hit = np.zeros(len(directions), dtype=bool)
        for piece in body.pieces:
            if len(piece.vertices) <= 2:
                middle = piece.vertices.mean(0) - p
                along = u @ middle
                hit |= (along > start) & (np.linalg.norm(middle - along[:, None] * u, axis=1) < piece.radius)
                continue
            normals, offsets = piece.planes
            slope, room = u @ normals.T, offsets + piece.radius - normals @ p
            flat = np.abs(slope) <= 1e-12
            way = room / np.where(flat, 1.0, slope)
            leave = np.where(~flat & (slope > 0), way, np.inf).min(axis=1)
            enter = np.where(~flat & (slope < 0), way, -np.inf).max(axis=1)
            hit |= ~(flat & (room < 0)).any(axis=1) & (leave > np.maximum(enter, start))
        cover += weight * hit
    return cover


def _model(body: Body, T: np.ndarray, seen: Callable[[np.ndarray], np.ndarray], color: tuple) -> Model:
    """Models of the pieces of a body for the renderer."""
    import trimesh

    mesh = trimesh.util.concatenate([piece.mesh() for piece in body.pieces])
    assert isinstance(mesh, trimesh.Trimesh)
    mesh.vertices = seen(transform_points(T, np.asarray(mesh.vertices)))
    return Model.of(mesh, color, crease=CREASE_ANGLE_DEG)


def _on_background(models: list[Model], camera: Camera) -> np.ndarray:
    right, down, forward = camera.axes
    image = render(models, camera, LIGHT_OFFSET[0] * right - LIGHT_OFFSET[1] * down - forward)
    return image[..., :3] * image[..., 3:] + np.array(BACKGROUND) * (1.0 - image[..., 3:])


def _annotate(draw: ImageDraw, marks: np.ndarray, pixels_per_metre: float) -> None:
    """Draw witness points, targets, the lines between them, and a scale.

    Args:
        draw: The oversampled picture.
        marks: Pixels (4, 2) of the witness points on a and b, then of the targets of a and b.
        pixels_per_metre: Scale of the final picture.
    """
    from PIL import ImageFont

    s = OVERSAMPLING
    halo = tuple((255 * np.array(BACKGROUND)).round().astype(int))
    # The ring of b is wider, so that both targets are visible where they coincide.
    rings = (marks[3], 11, MARK_B), (marks[2], 7, MARK_A)
    for point, (goal, radius, color) in zip((marks[1], marks[0]), rings, strict=True):
        way = goal - point
        stop = point + way * max(1.0 - radius * s / max(float(np.linalg.norm(way)), 1e-9), 0.0)
        draw.line([*point, *stop], fill=halo, width=5 * s)
        draw.line([*point, *stop], fill=color, width=2 * s)
    for goal, radius, color in rings:
        r = radius * s
        draw.ellipse([*(goal - r - s), *(goal + r + s)], outline=halo, width=5 * s)
        draw.ellipse([*(goal - r), *(goal + r)], outline=color, width=3 * s)
    for point, radius, color in ((marks[1], 6, MARK_B), (marks[0], 4, MARK_A)):
        r = radius * s
        draw.ellipse([*(point - r), *(point + r)], fill=color, outline=halo, width=s)
    length = 10.0 ** np.floor(np.log10(0.3 * WIDTH / pixels_per_metre))
    length *= max(k for k in (1, 2, 5) if k * length * pixels_per_metre <= 0.3 * WIDTH)
    x, y = 14 * s, (HEIGHT - 14) * s
    stop = x + length * pixels_per_metre * s
    draw.line([x, y, stop, y], fill=INK, width=2 * s)
    for end in (x, stop):
        draw.line([end, y - 4 * s, end, y + 4 * s], fill=INK, width=2 * s)
    font = ImageFont.load_default(12 * s)
    place = ((x + stop) / 2, y - 5 * s)
    draw.text(place, f"{1e3 * length:g} mm", INK, font, "md", stroke_width=3 * s, stroke_fill=halo)


def _on(feature: Feature) -> str:
    return {"vertex": "at a vertex", "edge": "on an edge"}.get(feature, f"on a {feature}")


def _mm(metres: float) -> str:
    """Format metres for people, with more digits for small values."""
    value = 1e3 * metres
    if value >= 0.95:
        return f"{value:.1f} mm"
    return f"{value:.2g} mm" if value >= 0.001 else "0 mm"
