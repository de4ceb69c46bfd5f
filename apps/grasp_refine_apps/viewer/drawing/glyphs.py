"""Lines, arrows and cones of contacts as arrays, in the object's frame."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float, Float32
from grasp_refine.core.se3 import tangents, transform_points
from grasp_refine.geometry.body import Body
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.viewer.drawing.depth import DepthPatch
from grasp_refine_apps.viewer.model.contacts import Patch

UNIT_FORCE_LENGTH = 0.5
"""Arrow length of a force of 1, the total pressure of all contacts, as a share of the object's diagonal."""

CONE_HEIGHT = 0.12
"""Height of a friction cone, likewise."""

PATCH_LIFT_M = 2e-4
"""Distance in metres of a drawn contact patch from the object, so that it is in front of it."""

CONE_SIDES, CONE_LINES = 24, 4
"""Segments of the rim of a drawn cone, and lines from there to its apex."""


def segments(start: Float[np.ndarray, "K 3"], end: Float[np.ndarray, "K 3"]) -> Float32[np.ndarray, "S 2 3"]:
    """End points (S, 2, 3) of lines between paired points, without lines that have a NaN."""
    both = np.stack([start, end], axis=1)
    return both[np.isfinite(both).all(axis=(1, 2))].astype(np.float32)


def push_arrow(
    prepared: HandObject,
    T_world_object: Float[np.ndarray, "4 4"],
    force: Float[np.ndarray, " 3"],
    extra: float,
    point: Float[np.ndarray, " 3"] | None = None,
) -> Float[np.ndarray, "2 3"]:
    """Start and end (2, 3) of the arrow of a push, through the surface of the object outwards.

    Args:
        prepared: The object, and a hand.
        T_world_object: Pose of the object.
        force: The push, not zero.
        extra: Length outside of the object.
        point: Point (3,) of the object that is pushed, object frame; None: the middle of the object.
    """
    points = transform_points(T_world_object, prepared.object.body.candidates.points)
    start = transform_points(T_world_object, np.mean(prepared.box, axis=0) if point is None else point)
    direction = force / np.linalg.norm(force)
    return np.stack([start, start + (max(((points - start) @ direction).max(), 0.0) + extra) * direction])


def arrow_lines(arrow: Float[np.ndarray, "2 3"], head: float) -> Float[np.ndarray, "5 2 3"]:
    """Line segments (5, 2, 3) that draw an arrow (2, 3) with a head of this length."""
    start, end = arrow
    direction = (end - start) / np.linalg.norm(end - start)
    sides = tangents(direction).T
    back = [end - head * (direction + 0.5 * sign * side) for side in sides for sign in (1.0, -1.0)]
    return np.stack([arrow, *(np.stack([end, point]) for point in back)])


def newtons_per_centimetre(obj: Body, total_n: float) -> float:
    """Return the force in newtons of a contact whose arrow is 1 cm long, where all pressures sum to `total_n`."""
    return 0.01 / (UNIT_FORCE_LENGTH * obj.diagonal) * total_n


def patch_outline(corners: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 2 3"]:
    """Return the edges (k, 2, 3) of a polygon (k, 3)."""
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def patch_area(patch: Patch) -> DepthPatch:
    """Return the area of a contact patch, a little in front of the object, coloured by the gap; a segment has none."""
    faces = np.array([[0, k, k + 1] for k in range(1, len(patch.corners) - 1)], dtype=np.int64).reshape(-1, 3)
    return DepthPatch((patch.corners - PATCH_LIFT_M * patch.normal).astype(np.float32), faces, -patch.gap)


def force_arrows(
    point: Float[np.ndarray, "C 3"], force: Float[np.ndarray, "C 3"], obj: Body
) -> Float32[np.ndarray, "S 2 3"]:
    """Start and end (S, 2, 3) of arrows from contact points into the object; forces that vanish have none.

    They lie in the friction cones. Their scale is the same for all grasps of an object.
    """
    arrow = UNIT_FORCE_LENGTH * obj.diagonal * np.asarray(force)
    pushing = np.linalg.norm(force, axis=1) > 1e-6
    return segments(np.asarray(point)[pushing], (point + arrow)[pushing])


def friction_cones(
    point: Float[np.ndarray, "C 3"], normal: Float[np.ndarray, "C 3"], friction: float, obj: Body
) -> Float32[np.ndarray, "S 2 3"]:
    """Line segments (S, 2, 3) that outline the friction cones: each opens from its contact along the normal, inwards.

    The half angle is atan(friction). Friction allows the forces inside the cone.
    """
    height = CONE_HEIGHT * obj.diagonal
    normal, point = np.asarray(normal, dtype=np.float64), np.asarray(point, dtype=np.float64)
    turn = np.linspace(0.0, 2 * np.pi, CONE_SIDES, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    rim = (point + height * normal)[:, None] + friction * height * (tangents(normal) @ circle).mT
    around = np.stack([rim, np.roll(rim, -1, axis=1)], axis=2)
    sides = rim[:, :: CONE_SIDES // CONE_LINES]
    sides = np.stack([np.broadcast_to(point[:, None], sides.shape), sides], axis=2)
    return np.concatenate([around, sides], axis=1).reshape(-1, 2, 3).astype(np.float32)
