"""Lines, arrows and cones of contacts as arrays, in the object's frame."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, UInt32

from grasp_refine.core.se3 import tangents, transform_points
from grasp_refine.geometry.body import Body
from grasp_refine.scene.hand_object import HandObject

UNIT_FORCE_LENGTH = 0.5
"""Arrow length of a force of 1, the total pressure of all contacts, as a share of the object's diagonal."""

CONE_HEIGHT = 0.12
"""Height of a friction cone, likewise."""

CONE_SIDES = 24
"""Sides of the pyramids that are drawn for cones."""


def segments(start: Float[np.ndarray, "K 3"], end: Float[np.ndarray, "K 3"]) -> Float32[np.ndarray, "S 2 3"]:
    """End points (S, 2, 3) of lines between paired points, without those that have a NaN."""
    both = np.stack([start, end], axis=1)
    return both[np.isfinite(both).all(axis=(1, 2))].astype(np.float32)


def push_arrow(
    prepared: HandObject, T_world_object: Float[np.ndarray, "4 4"], force: Float[np.ndarray, " 3"], extra: float
) -> Float[np.ndarray, "2 3"]:
    """Start and end (2, 3) of the arrow of a push, from the middle of the object through its surface outwards.

    Args:
        prepared: The object, and a hand.
        T_world_object: Pose of the object.
        force: The push, not zero.
        extra: Length outside of the object.
    """
    points = transform_points(T_world_object, prepared.object.body.candidates.points)
    middle = transform_points(T_world_object, np.mean(prepared.box, axis=0))
    direction = force / np.linalg.norm(force)
    return np.stack([middle, middle + (((points - middle) @ direction).max() + extra) * direction])


def arrow_lines(arrow: Float[np.ndarray, "2 3"], head: float) -> Float[np.ndarray, "5 2 3"]:
    """Line segments (5, 2, 3) that draw an arrow (2, 3) with a head of this length."""
    start, end = arrow
    direction = (end - start) / np.linalg.norm(end - start)
    sides = tangents(direction).T
    back = [end - head * (direction + 0.5 * sign * side) for side in sides for sign in (1.0, -1.0)]
    return np.stack([arrow, *(np.stack([end, point]) for point in back)])


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
) -> tuple[Float32[np.ndarray, "V 3"], UInt32[np.ndarray, "F 3"]]:
    """Vertices and faces of all friction cones together: each opens from its contact along the normal, into the object.

    The half angle is atan(friction). The forces that friction allows are those in the cone.
    """
    import trimesh

    height = CONE_HEIGHT * obj.diagonal
    cone = trimesh.creation.cone(friction * height, height, sections=CONE_SIDES)
    # The apex of this cone is on its axis z, its base in the plane z = 0.
    normal = np.asarray(normal, dtype=np.float64)
    axes = np.concatenate([tangents(normal)[..., ::-1], -normal[..., None]], axis=-1)
    vertices = (point + height * normal)[:, None] + np.asarray(cone.vertices) @ axes.mT
    faces = np.asarray(cone.faces) + len(cone.vertices) * np.arange(len(point))[:, None, None]
    return vertices.reshape(-1, 3).astype(np.float32), faces.reshape(-1, 3).astype(np.uint32)
