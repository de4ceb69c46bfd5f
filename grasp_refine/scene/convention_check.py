"""Signs that a grasp file uses other conventions than were read: other units, quaternions, or frames.

Joint values are checked against the joint limits, poses by the positions of the fingers. A grasp is *near* when its
second nearest finger is at most `NEAR_M` from the object, the depth of its deepest link added. In the sets tested
(BODex and DexGraspNet on the Shadow hand, FRoGGeR on Allegro, LEAP holding a cube) 99 % or more of the grasps are near
in the right convention, and at most 25 % in a wrong one, for any `NEAR_M` from 10 to 20 mm. Of imprecise grasps, each
3 to 10 cm or 30 degrees off, at most 15 % are near in any other reading at 15 mm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from grasp_refine.collision.query import query
from grasp_refine.core.se3 import inverse, pose_from_transform, transform_from_pose
from grasp_refine.hands.hand import Hand
from grasp_refine.scene.contact_selection import PALM, link_groups
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene, links_of

MAX_SAMPLES = 32
"""Most grasps of a file that are checked."""

IMPLAUSIBLE_SHARE, PLAUSIBLE_SHARE = 0.33, 0.8
"""A reading is implausible when at most this share of the grasps agrees with it, plausible when at least this does."""

NEAR_M = 0.015
"""Distance of the second nearest finger from the object, plus the depth of the deepest link, of a grasp, in metres."""

APART_M = 0.2
"""A hand with no link within this distance of the object, in metres, is not at it."""

LIMIT_TOLERANCE_RAD = 0.1
"""Largest distance of joint values beyond their limits."""

FULL_TURN_RAD = 2.0 * np.pi
"""Distance beyond the limits of a joint that no angle in radians exceeds."""

MAX_POSITION_M = 2.0
"""Distance of a hand from the origin of its object, in metres, beyond which the unit is probably another one."""

MIN_POSES = 4
"""Fewest different poses by which other frames and quaternion orders are recognised: fewer may be near by chance."""

Poses = Float[np.ndarray, "N 7"]
"""x y z (metres), qw qx qy qz, as in `GraspSet.hand_pose`."""


@dataclass(frozen=True)
class Convention:
    """Another convention of the poses in a file."""

    looks: str
    """Symptom, for the note."""
    needed: str
    """Required convention, for the note."""
    read: Callable[[Poses], Poses]
    """Converts poses in this convention to ours."""
    unit: bool = False
    """Whether it is a unit, which shows in single grasps: their hands, as read, are far away."""


def _scaled(factor: float) -> Callable[[Poses], Poses]:
    return lambda pose: pose * np.array([factor] * 3 + [1.0] * 4)


CONVENTIONS = (
    Convention("positions look like millimetres", "in metres", _scaled(1e-3), unit=True),
    Convention("positions look like centimetres", "in metres", _scaled(1e-2), unit=True),
    Convention("quaternions look like x y z w", "w x y z", lambda pose: pose[:, [0, 1, 2, 6, 3, 4, 5]]),
    Convention(
        "poses look like those of the object in the hand's frame",
        "those of the hand in the object's frame",
        lambda pose: pose_from_transform(inverse(transform_from_pose(pose))),
    ),
)
"""All other conventions, in the order in which they are undone."""


def convention_notes(scenes: Sequence[Scene]) -> tuple[str, ...]:
    """Notes on the conventions that a file most likely uses, where they are clearly not those that were read.

    Args:
        scenes: The grasps of one hand, as read, by object.

    Returns:
        A line each for joint values and poses; none where they are plausible, or no other convention is.
    """
    found = [np.flatnonzero(scene.posed) for scene in scenes]
    number = np.repeat(np.arange(len(scenes)), [len(rows) for rows in found])
    chosen = np.sort(np.random.default_rng(0).permutation(len(number))[:MAX_SAMPLES])
    if not len(chosen):
        return ()
    number, row = number[chosen], np.concatenate(found)[chosen]
    hand, each = scenes[0].hand, list(zip(number.tolist(), row.tolist(), strict=True))
    pose = pose_from_transform(np.stack([scenes[k].T_world_root[i] for k, i in each]))
    q = np.stack([scenes[k].q[i] for k, i in each])
    notes = joint_notes(hand, q)
    once, number = np.unique(number, return_inverse=True)
    at = _Objects(tuple(HandObject.of(scenes[k]) for k in once.tolist()), number)
    return (*notes, *_pose_notes(hand, at, pose, np.radians(q) if notes else q))


def joint_notes(hand: Hand, q: Float[np.ndarray, "N n"]) -> tuple[str, ...]:
    """Note that joint values look like degrees, if they do; values (N, n) in `hand.joint_names` order."""
    hinge = [hand.joints_by_name[name].kind == "revolute" for name in hand.joint_names]
    q, lower, upper = q[np.isfinite(q).all(axis=1)][:, hinge], hand.lower[hinge], hand.upper[hinge]
    if not q.size:
        return ()

    def beyond(values: np.ndarray) -> np.ndarray:
        return np.maximum(lower - values, values - upper).max(axis=1)

    as_read, as_degrees = beyond(q), beyond(np.radians(q)) <= LIMIT_TOLERANCE_RAD
    if np.mean(as_degrees & (as_read > FULL_TURN_RAD)) < PLAUSIBLE_SHARE:
        return ()
    return (
        f"joint values look like degrees: as such, {as_degrees.sum()} of {len(q)} grasps lie within the joint limits, "
        f"as given {(as_read <= LIMIT_TOLERANCE_RAD).sum()}; they must be in radians",
    )


def position_notes(pose: Poses) -> tuple[str, ...]:
    """Note that positions are not in metres, if they are too large for that; poses without an object."""
    # The largest coordinate, whose square need not be a number.
    away = np.abs(pose[np.isfinite(pose).all(axis=1), :3]).max(axis=1)
    if not len(away) or np.median(away) <= MAX_POSITION_M:
        return ()
    return (
        f"positions look like millimetres or centimetres: half of the {len(away)} hands are "
        f"{np.median(away):.3g} or more from their object's origin; they must be in metres",
    )


@dataclass(frozen=True, eq=False)
class _Objects:
    """The objects of N grasps."""

    prepared: tuple[HandObject, ...]
    """Hand and object, each object once."""
    number: np.ndarray
    """Index (N,) of each grasp's object in `prepared`."""

    def distances(self, pose: Poses, q: np.ndarray, cutoff: float) -> tuple[np.ndarray, np.ndarray]:
        """Signed distances (N,) of the second nearest finger and of the nearest link, in metres, up to a cutoff."""
        finger, link = np.empty((2, len(q)))
        for k, prepared in enumerate(self.prepared):
            at = np.flatnonzero(self.number == k)
            T = prepared.chain(transform_from_pose(pose[at]), q[at]).T_world_link
            distance = query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape), cutoff=cutoff).distance
            by_finger = [distance[:, columns].min(axis=1) for columns in _fingers(prepared.hand)]
            finger[at], link[at] = np.sort(by_finger, axis=0)[1], distance.min(axis=1)
        return finger, link

    def near(self, pose: Poses, q: np.ndarray) -> Bool[np.ndarray, " N"]:
        """Mask (N,) of the grasps that are near their object."""
        finger, link = self.distances(pose, q, 2.0 * NEAR_M)
        return np.maximum(finger, 0.0) + np.maximum(-link, 0.0) <= NEAR_M


def _fingers(hand: Hand) -> list[np.ndarray]:
    """Columns of the contact links of each finger among the links with collision geometry."""
    links = links_of(hand)
    groups = np.array(link_groups(hand, links))
    touching = np.isin(links, [contact.link for contact in hand.contacts])
    return [np.flatnonzero((groups == name) & touching) for name in np.unique(groups[touching]) if name != PALM]


def _pose_notes(hand: Hand, at: _Objects, pose: Poses, q: np.ndarray) -> tuple[str, ...]:
    """Note on the convention that poses look like, where they are not plausible."""
    # The poses of a hand with one finger show nothing.
    if len(_fingers(hand)) < 2 or (as_read := at.near(pose, q)).mean() > IMPLAUSIBLE_SHARE:
        return ()
    apart = at.distances(pose, q, APART_M)[1] >= APART_M
    several = len(np.unique(pose.round(6), axis=0)) >= MIN_POSES
    readings = [
        kinds
        for count in (1, 2)
        for kinds in combinations(CONVENTIONS, count)
        if sum(kind.unit for kind in kinds) <= 1
        and (several or (count == 1 and kinds[0].unit))
        and (apart.mean() >= PLAUSIBLE_SHARE or not any(kind.unit for kind in kinds))
    ]
    near = [at.near(reduce(lambda poses, kind: kind.read(poses), kinds, pose), q).sum() for kinds in readings]
    # Of equally good ones the simplest, which comes first.
    best = int(np.argmax(near)) if near else -1
    if best >= 0 and near[best] >= PLAUSIBLE_SHARE * len(pose):
        looks, needed = (" and ".join(getattr(kind, key) for kind in readings[best]) for key in ("looks", "needed"))
        return (
            f"{looks}: as such, two fingers come within {1e3 * NEAR_M:.0f} mm of the object in {near[best]} of "
            f"{len(pose)} grasps, as given in {as_read.sum()}; they must be {needed}",
        )
    if apart.mean() < PLAUSIBLE_SHARE:
        return ()
    return (
        f"hand and object are far apart: in {apart.sum()} of {len(pose)} grasps no part of the hand comes within "
        f"{1e2 * APART_M:.0f} cm; poses must be those of link '{hand.base_link}' in the object's frame, in metres",
    )
