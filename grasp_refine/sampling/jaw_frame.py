"""Jaw frame of a gripper with two fingers that face each other and close along one line: its width and its pads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.collision.culling import bounding_sphere
from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import matvec, transform, transform_points
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Contact, Hand
from grasp_refine.sampling.closure_frame import ClosureFrame

NUM_WIDTHS = 33
"""Number of openings, evenly from open to closed, at which jaws are examined."""

MAX_TILT_RAD = np.radians(12.0)
"""Largest angle in radians between the direction in which jaws close and the normals of their pads, at any opening."""

PAD_DEPTH_M = 1.5e-3
"""Depth in metres behind the front of a finger, or behind its contact point, within which its surface is of the pad."""

MIN_STROKE_M = 5e-3
"""Least difference in metres between the widths of open and of closed jaws."""


@dataclass(frozen=True, eq=False)
class JawFrame:
    """Axes of two jaws in the frame of the base link, and K openings from open to closed."""

    groups: tuple[str, str]
    """Fingers: the first moves along `axis` as the jaws close, the second against it."""
    axis: Float[np.ndarray, " 3"]
    """Unit vector (3,) along which the jaws close."""
    approach: Float[np.ndarray, " 3"]
    """Unit vector (3,) at a right angle to it, from the palm to the pads."""
    q: Float[np.ndarray, "K n"]
    """Joint values (K, n) of the openings, rad or m; joints that do not close the jaws rest."""
    width: Float[np.ndarray, " K"]
    """Distance (K,) between the pads in metres, falling."""
    center: Float[np.ndarray, "K 3"]
    """Middle (K, 3) between the pads, metres."""
    half_length: float
    """Half of the length along `approach` over which both pads face each other, metres."""
    half_breadth: float
    """Half of their breadth at right angles to both axes, metres."""

    def at(self, width: Float[np.ndarray, " M"]) -> tuple[Float[np.ndarray, "M n"], Float[np.ndarray, "M 3"]]:
        """Joint values (M, n) and middles (M, 3) between the pads at widths in metres, which are clipped to the stroke.

        Between the examined openings both are interpolated, which is exact where the jaws slide.
        """
        # np.interp wants rising places.
        columns = np.hstack([self.q, self.center])[::-1].T
        values = np.stack([np.interp(width, self.width[::-1], column) for column in columns], axis=-1)
        return values[:, : self.q.shape[1]], values[:, self.q.shape[1] :]

    def poses(
        self,
        middle: Float[np.ndarray, "M 3"],
        axis: Float[np.ndarray, "M 3"],
        way: Float[np.ndarray, "M 3"],
        center: Float[np.ndarray, "M 3"],
    ) -> Float[np.ndarray, "M 4 4"]:
        """Poses (M, 4, 4) of the base link that bring `center`, in its frame, to `middle`.

        Args:
            middle: Points in the object's frame.
            axis: Unit vectors along which the jaws close, object frame.
            way: Unit vectors at right angles to these along which the hand approaches, object frame.
            center: Middles between the pads, as of `at`.
        """
        ours = np.column_stack([self.axis, np.cross(self.approach, self.axis), self.approach])
        R = np.stack([axis, np.cross(way, axis), way], axis=-1) @ ours.T
        return transform(R, middle - matvec(R, center))


def jaw_frame(hand: Hand, closure: ClosureFrame) -> JawFrame | None:
    """The jaw frame of a hand; None for a hand that is no gripper with two jaws.

    A gripper has two groups of contact links, each with a pad: surface that looks, within `MAX_TILT_RAD`, along the
    direction in which the fingers approach each other, at every opening, and that lies in part opposite the other pad.
    Jaws may slide, or turn on linkages that keep them parallel; each may have an actuator of its own.
    """
    if not hand.has_two_fingers or not closure.closing.any():
        return None
    first, second = names = hand.fingers
    closed = np.where(closure.closing > 0, closure.upper, closure.lower)
    begin, end = (np.where(closure.closing == 0, hand.rest, each) for each in (closure.opened, closed))
    q = np.linspace(begin, end, NUM_WIDTHS)
    contacts = {name: [contact for contact in hand.contacts if contact.group == name] for name in names}
    links = [contact.link for name in names for contact in contacts[name]]
    T = Chain(hand, links)(np.tile(np.eye(4), (NUM_WIDTHS, 1, 1)), q).T_world_link
    middle = transform_points(T, np.array([bounding_sphere(hand.links_by_name[link].solid)[:3] for link in links]))
    of = np.array([contact.group for name in names for contact in contacts[name]]) == first
    apart = middle[:, ~of].mean(axis=1) - middle[:, of].mean(axis=1)
    moved = apart[0] - apart[-1]
    if not np.linalg.norm(moved) > MIN_STROKE_M:
        return None
    axis = moved / np.linalg.norm(moved)
    approach = closure.approach - (closure.approach @ axis) * axis
    if not np.linalg.norm(approach) > 0.5:
        return None
    approach /= np.linalg.norm(approach)
    aside = np.cross(approach, axis)
    fronts, low, high = [], [], []
    for name, sign in ((first, 1.0), (second, -1.0)):
        rows = [row for row, group in enumerate(of) if group == (name == first)]
        pad = _pad(hand, contacts[name], T[:, rows], sign * axis)
        if pad is None:
            return None
        along = np.stack([pad @ approach, pad @ aside], axis=-1)
        fronts.append((pad @ axis).mean(axis=1))
        low.append(along.min(axis=1))
        high.append(along.max(axis=1))
    width = fronts[1] - fronts[0]
    low_both, high_both = np.maximum(*low), np.minimum(*high)
    if (np.diff(width) >= 0.0).any() or (high_both <= low_both).any():
        return None
    across = 0.5 * (low_both + high_both)
    center = 0.5 * sum(fronts)[:, None] * axis + across[:, :1] * approach + across[:, 1:] * aside
    half = 0.5 * (high_both - low_both).min(axis=0)
    return JawFrame((first, second), axis, approach, q, np.maximum(width, 0.0), center, float(half[0]), float(half[1]))


def _pad(
    hand: Hand, contacts: list[Contact], T: Float[np.ndarray, "K C 4 4"], normal: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "K P 3"] | None:
    """Surface points (K, P, 3) of the pad of a finger at K openings; None where it has none at some opening."""
    clouds = [hand.links_by_name[contact.link].solid.candidates for contact in contacts]
    points = np.concatenate([transform_points(T[:, i, None], cloud.points) for i, cloud in enumerate(clouds)], axis=1)
    normals = np.concatenate([cloud.normals @ T[:, i, :3, :3].mT for i, cloud in enumerate(clouds)], axis=1)
    facing = (normals @ normal >= np.cos(MAX_TILT_RAD)).all(axis=0)
    if not facing.any():
        return None
    points = points[:, facing]
    height = (points[0] @ normal).max()
    heights = [
        transform_points(T[0, i], np.array(contact.point)) @ normal
        for i, contact in enumerate(contacts)
        if contact.point is not None
    ]
    if heights:
        height = max(heights)
    pad = points[:, np.abs(points[0] @ normal - height) <= PAD_DEPTH_M]
    return pad if pad.shape[1] else None
