"""Closure frame of a hand, from its kinematics: the joints that close it, and the centre between its fingers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.collision.culling import bounding_sphere
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.errors import HandError
from grasp_refine.core.se3 import tangents, transform_points
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.files.tree import joints_above
from grasp_refine.hands.hand import Hand, Joint
from grasp_refine.scene.contact_selection import PALM, link_groups

MIN_PARALLEL_COSINE = 0.7
"""Least cosine between the axes of two joints of a finger that both bend it."""

CLOSING_RANGE_SHARE = 0.9
"""Share of the range of its joints over which the closing direction of a finger is found."""

MIN_CURL_SHARE = 0.1
"""Least share of its length by which a finger that curls gets shorter over that range."""

PARALLEL_TURN_SHARE = 0.05
"""Largest share of the turning of its joints by which a finger on a linkage turns that keeps it parallel to itself."""

MIN_MEAN_DIRECTION = 0.05
"""Length of the mean of the directions in which the palm is seen, below which it lies on all sides."""


@dataclass(frozen=True, eq=False)
class ClosureFrame:
    """Centre and axes of the grasps of a hand, in the frame of its base link, and closing motion of its n joints."""

    center: Float[np.ndarray, " 3"]
    """Centre (3,) of the smallest sphere around the fingertips at rest, in metres: where objects are held."""
    radius: float
    """Radius of that sphere, in metres."""
    approach: Float[np.ndarray, " 3"]
    """Unit vector (3,) from the palm to the centre, the direction in which the hand approaches."""
    across: Float[np.ndarray, " 3"]
    """Unit vector (3,) at a right angle to `approach`, the direction in which fingertips move when the hand closes."""
    closing: Float[np.ndarray, " n"]
    """1 or -1 for an independent joint that bends a finger: its values rise or fall as this closes; 0 for others."""
    spreading: Bool[np.ndarray, " n"]
    """Mask (n,) of joints of fingers that do not bend them, but spread or oppose them."""
    lower: Float[np.ndarray, " n"]
    """Lower limits (n,) in rad or m; for continuous joints a quarter turn from rest."""
    upper: Float[np.ndarray, " n"]
    """Upper limits (n,) in rad or m; for continuous joints a quarter turn from rest."""
    opened: Float[np.ndarray, " n"]
    """Joint values (n,) at which the fingers are open as far as they go, in rad or m."""
    opening: float
    """Diameter of the smallest sphere around the fingertips then, in metres."""


def closure_frame(hand: Hand) -> ClosureFrame:
    """The closure frame of a hand around its rest pose.

    The last joint of a finger bends it, as do parallel joints above it. They close it in the
    direction in which it curls, that is in which its tip approaches its knuckle, or, for a finger that keeps its
    length or stays parallel to itself, the centre of all tips. Joints that carry all fingers belong to a wrist and are
    left out.

    Raises:
        HandError: no joint of the hand moves a link that is meant to touch, or none within its limits.
    """
    fingers = _fingers(hand)
    if not fingers:
        raise HandError(
            f"hand '{hand.name}' cannot grip: none of its joints moves a link that is meant to touch, within its limits"
        )
    palm, facing = _palm(hand)

    def tips(q: np.ndarray) -> np.ndarray:
        """Points (B, K, 3) in the middle of the contacts of each finger, at joint values (B, n)."""
        T = Chain(hand, [contact.link for contact in hand.contacts])(np.tile(np.eye(4), (len(q), 1, 1)), q).T_world_link
        points = transform_points(T, np.array([_pad(hand, i) for i in range(len(hand.contacts))]))
        return np.stack([points[:, contacts].mean(axis=1) for contacts, _ in fingers], axis=1)

    def tip_sphere(q: np.ndarray) -> tuple[np.ndarray, float]:
        points = tips(q[None])[0]
        # A single finger closes against the rest of the hand.
        return _smallest_sphere(points if len(points) > 1 else np.append(points, [palm.mean(axis=0)], axis=0))

    center, radius = tip_sphere(hand.rest)
    lower = np.where(np.isfinite(hand.lower), hand.lower, hand.rest - 0.5 * np.pi)
    upper = np.where(np.isfinite(hand.upper), hand.upper, hand.rest + 0.5 * np.pi)
    moves, bends, parallel, knuckle = (
        np.array(each) for each in zip(*(_bending(hand, path) for _, path in fingers), strict=True)
    )
    middle, span = 0.5 * (lower + upper), 0.5 * CLOSING_RANGE_SHARE * (upper - lower) * bends
    own = np.arange(len(fingers))
    before, after = (tips(np.where(bends == 0, hand.rest, at))[own, own] for at in (middle - span, middle + span))
    length, to_center = (
        [np.linalg.norm(tip - point, axis=1) for tip in (before, after)] for point in (knuckle, center)
    )
    curl = length[0] - length[1]
    slides = np.array([path[0].kind == "prismatic" for _, path in fingers])
    stiff = slides | parallel | (np.abs(curl) < MIN_CURL_SHARE * np.maximum(*length))
    closing = np.sign(np.where(stiff, to_center[0] - to_center[1], curl) @ bends)

    approach = _away_from(palm, facing, center)
    step = 1e-3 * closing
    moved = tips((hand.rest + step)[None])[0] - tips((hand.rest - step)[None])[0]
    opened = np.where(closing == 0, hand.rest, np.where(closing > 0, lower, upper))
    # Fingertips move most along one direction across the approach.
    basis = tangents(approach)
    return ClosureFrame(
        center=center,
        radius=radius,
        approach=approach,
        across=basis @ np.linalg.svd(moved @ basis)[2][0],
        closing=closing,
        spreading=moves.any(axis=0) & (closing == 0),
        lower=lower,
        upper=upper,
        opened=opened,
        opening=2.0 * tip_sphere(opened)[1],
    )


def _fingers(hand: Hand) -> list[tuple[list[int], list[Joint]]]:
    """For each group of contacts that can move: its contacts, and its joints from the last one to the palm."""
    groups: dict[str, list[int]] = {}
    for i, contact in enumerate(hand.contacts):
        groups.setdefault(contact.group, []).append(i)
    matrix, _, names = hand.mimic_map()
    ranged = {name for name, gains in zip(names, matrix, strict=True) if gains[hand.lower < hand.upper].any()}
    fingers = []
    for contacts in groups.values():
        above = joints_above(hand.contacts[contacts[0]].link, hand.joints)
        fingers.append((contacts, [joint for joint in above if joint.movable and joint.name in ranged]))
    carrying = [{joint.name for joint in path} for _, path in fingers if path]
    wrist = set.intersection(*carrying) if len(carrying) > 1 else set()
    own = [(contacts, [joint for joint in path if joint.name not in wrist]) for contacts, path in fingers]
    return [(contacts, path) for contacts, path in own if path]


def _pad(hand: Hand, index: int) -> np.ndarray:
    """The point (3,) of a contact in its link's frame; without one, the middle of the link."""
    contact = hand.contacts[index]
    if contact.point is not None:
        return np.array(contact.point)
    return bounding_sphere(hand.links_by_name[contact.link].solid)[:3]


def _bending(hand: Hand, path: list[Joint]) -> tuple[np.ndarray, np.ndarray, bool, np.ndarray]:
    """Mask (n,) of the joints that move a finger; the sign (n,) with which they bend it, or 0; and its knuckle (3,).

    Before the knuckle comes whether a joint moves the finger parallel to itself, as the bars of a gripper do that turn
    as far one way as the finger turns back. Its sign is that of the bar at the palm. Positive bending may close or open
    the finger; it is the same for all joints of one finger.
    """
    matrix, _, movable = hand.mimic_map()
    frames = Chain(hand, [joint.child for joint in path])(np.eye(4)[None], hand.rest[None]).T_world_link[0]
    axes = [T[:3, :3] @ joint.axis for T, joint in zip(frames, path, strict=True)]
    gains = np.array([matrix[movable.index(joint.name)] for joint in path])
    alike = np.array([axis @ axes[0] for axis in axes])
    kind = np.array([(joint.kind == "prismatic") == (path[0].kind == "prismatic") for joint in path])
    turns = np.where(kind & (np.abs(alike) > MIN_PARALLEL_COSINE), np.sign(alike), 0.0)[:, None] * gains
    total, travel = turns.sum(axis=0), np.abs(turns).sum(axis=0)
    still = (travel > 0.0) & (np.abs(total) <= PARALLEL_TURN_SHARE * travel)
    at_palm = turns[len(turns) - 1 - (turns[::-1] != 0.0).argmax(axis=0), np.arange(turns.shape[1])]
    bends = np.sign(np.where(still, at_palm, total))
    return (gains != 0).any(axis=0), bends, bool(still.any()), frames[-1, :3, 3]


def _palm(hand: Hand) -> tuple[np.ndarray, np.ndarray]:
    """Points (P, 3) of the palm's surface, of all links if it has none, and outward normals times areas."""
    solid = tuple(link.name for link in hand.links if link.body is not None)
    palm = [link for link, group in zip(solid, link_groups(hand, solid), strict=True) if group == PALM] or solid
    points, facing = [], []
    for link, T in zip(palm, Chain(hand, palm)(np.eye(4)[None], hand.rest[None]).T_world_link[0], strict=True):
        surface = hand.links_by_name[link].solid.candidates
        points.append(transform_points(T, surface.points))
        facing.append(surface.areas[:, None] * surface.normals @ T[:3, :3].T)
    return np.concatenate(points), np.concatenate(facing)


def _away_from(points: np.ndarray, facing: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Unit vector (3,) away from a surface as seen from the centre, each part of it weighted by its solid angle."""
    sight = center - points
    distance = np.linalg.norm(sight, axis=1, keepdims=True)
    solid_angle = np.maximum((facing * sight).sum(axis=1, keepdims=True) / distance**3, 0.0)
    mean = (solid_angle * sight / distance).sum(axis=0)
    if np.linalg.norm(mean) <= MIN_MEAN_DIRECTION * solid_angle.sum():
        mean = center if center.any() else np.array([0.0, 0.0, 1.0])
    return mean / np.linalg.norm(mean)


def _smallest_sphere(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) and radius of the smallest sphere around points, nearly: ever smaller steps towards the farthest."""
    center = points.mean(axis=0)
    for step in range(2, 200):
        center = center + (points[np.linalg.norm(points - center, axis=1).argmax()] - center) / step
    return center, float(np.linalg.norm(points - center, axis=1).max())
