"""Directions of a gripper's jaws in the frame of its base link, for files that give poses of a gripper by its jaws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.collision.culling import bounding_sphere
from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import transform, transform_points
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand

MIN_STROKE_M = 5e-3
"""Least change of the distance between two fingers by which they are jaws, metres."""

MIN_JOINT_STROKE_M = 1e-3
"""Least part of it by which a joint opens them, metres."""

SNAP_COSINE = np.cos(np.radians(25.0))
"""Least cosine between a direction and an axis of the base link that is taken for it."""


@dataclass(frozen=True, eq=False)
class Jaws:
    """Two fingers that close towards each other."""

    axis: Float[np.ndarray, " 3"]
    """Unit vector (3,) along which they open, towards the first finger, frame of the base link."""
    approach: Float[np.ndarray, " 3"]
    """Unit vector (3,) at a right angle to it, from the palm to the fingers."""
    opened: Float[np.ndarray, " n"]
    """Joint values (n,) at which they are as far apart as they go, rad or m; other joints rest."""
    closed: Float[np.ndarray, " n"]
    """Joint values (n,) at which they are as near as they go."""

    @property
    def T_jaws_base(self) -> Float[np.ndarray, "4 4"]:
        """Pose (4, 4) of the base link in a frame at its origin with x along `axis` and z along `approach`."""
        return transform(np.stack([self.axis, np.cross(self.approach, self.axis), self.approach]), np.zeros(3))


def jaws_of(hand: Hand) -> Jaws | None:
    """Return the jaws of a hand; None for a hand without two fingers whose distance changes.

    Each joint opens the jaws towards the limit at which they are farther apart. Directions near an axis of the base
    link are along it.
    """
    if not hand.has_two_fingers:
        return None
    ends = np.where(np.isfinite([hand.lower, hand.upper]), [hand.lower, hand.upper], hand.rest)
    # The rest pose, then each joint at its lower and upper limit.
    count = len(hand.rest)
    q = np.tile(hand.rest, (2 * count + 1, 1))
    for joint in range(count):
        q[1 + 2 * joint : 3 + 2 * joint, joint] = ends[:, joint]
    between = np.linalg.norm(np.diff(_fingers(hand, q), axis=1)[:, 0], axis=1)[1:].reshape(count, 2)
    moves = np.abs(np.diff(between, axis=1)[:, 0]) >= MIN_JOINT_STROKE_M
    lower = between[:, 0] > between[:, 1]
    opened, closed = (np.where(moves, np.where(lower == side, *ends), hand.rest) for side in (True, False))
    fingers = _fingers(hand, np.stack([opened, closed]))
    stroke = np.subtract(*(fingers[:, 0] - fingers[:, 1]))
    if not np.linalg.norm(stroke) >= MIN_STROKE_M:
        return None
    axis = _snapped(stroke)
    ahead = fingers.mean(axis=(0, 1)) - _palm(hand)
    ahead = _snapped(ahead - (ahead @ axis) * axis)
    approach = ahead - (ahead @ axis) * axis
    length = np.linalg.norm(approach)
    return Jaws(axis, approach / length, opened, closed) if length > 0.5 else None


def _fingers(hand: Hand, q: Float[np.ndarray, "B n"]) -> Float[np.ndarray, "B 2 3"]:
    """Return the middles (B, 2, 3) of the contact links of both fingers in the frame of the base link."""
    T = Chain(hand, [contact.link for contact in hand.contacts])(np.tile(np.eye(4), (len(q), 1, 1)), q).T_world_link
    points = [bounding_sphere(hand.links_by_name[contact.link].solid)[:3] for contact in hand.contacts]
    middle = transform_points(T, np.array(points))
    groups = np.array([contact.group for contact in hand.contacts])
    return np.stack([middle[:, groups == finger].mean(axis=1) for finger in hand.fingers], axis=1)


def _palm(hand: Hand) -> Float[np.ndarray, " 3"]:
    """Return the middle (3,) of the links that stand still against the base link; its origin if they are bare."""
    solid = [link for link in hand.fixed_to(hand.base_link) if hand.links_by_name[link].body is not None]
    if not solid:
        return np.zeros(3)
    T = Chain(hand, solid)(np.eye(4)[None], hand.rest[None]).T_world_link
    points = np.array([bounding_sphere(hand.links_by_name[link].solid)[:3] for link in solid])
    return transform_points(T, points)[0].mean(axis=0)


def _snapped(direction: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Return a unit vector (3,), along the nearest axis where that is near."""
    length = np.linalg.norm(direction)
    unit = direction / length if length > 0.0 else direction
    nearest = np.abs(unit).argmax()
    if np.abs(unit[nearest]) < SNAP_COSINE:
        return unit
    return np.sign(unit[nearest]) * np.eye(3)[nearest]
