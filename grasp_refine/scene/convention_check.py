"""Signs that a grasp file uses other conventions than were read: other units, quaternions, or frames.

Joint values are checked against the joint limits, poses by the positions of the fingers. A grasp is *near* when its
second nearest finger is at most `NEAR_M` from the object, the depth of its deepest link added. In the sets tested
(BODex and DexGraspNet on the Shadow hand, FRoGGeR on Allegro, LEAP holding a cube) 99 % or more of the grasps are near
in the right convention, and at most 25 % in a wrong one, for any `NEAR_M` from 10 to 20 mm. Of imprecise grasps, each
3 to 10 cm or 30 degrees off, at most 15 % are near in any other reading at 15 mm.

Of one to three grasps each must be far as read and very near in another reading, by `FEW_FAR_M` and `FEW_NEAR_M`: of
164 single grasps of these sets and of the embedded examples, none is so as it was published, none when moved by 3 to
10 cm or turned by 20 to 60 degrees, and 88 % are with quaternions x y z w.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from grasp_refine.collision.query import query
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.errors import ConventionError
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

BEYOND_RAD = 0.5
"""Distance beyond the limits of a joint, in radians, from which the fingers show whether the values are degrees."""

MIN_POSES = 4
"""Fewest different poses by which other readings are recognised at `NEAR_M`: fewer may be near by chance."""

FEW_FAR_M, FEW_NEAR_M = 0.03, 0.008
"""Distances as `NEAR_M`, in metres: fewer poses must be at least the first as read, at most the second otherwise."""

Poses = Float[np.ndarray, "N 7"]
"""x y z (metres), qw qx qy qz, as in `GraspSet.hand_pose`."""


def _same(values: np.ndarray) -> np.ndarray:
    return values


@dataclass(frozen=True)
class Convention:
    """Another convention of the poses or joint values in a file."""

    looks: str
    """Symptom, for the note."""
    needed: str
    """Required convention, for the note."""
    read: Callable[[Poses], Poses]
    """Converts poses (N, 7) in this convention to ours."""
    unit: bool = False
    """Whether it is a unit of length, which shows in single grasps: their hands, as read, are far away."""
    joints: Callable[[np.ndarray], np.ndarray] = _same
    """Converts joint values (N, n) in this convention to ours."""


def _scaled(factor: float) -> Callable[[Poses], Poses]:
    return lambda pose: pose * np.array([factor] * 3 + [1.0] * 4)


DEGREES = Convention("joint values look like degrees", "in radians", _same, joints=np.radians)
CONVENTIONS = (
    DEGREES,
    Convention("positions look like millimetres", "in metres", _scaled(1e-3), unit=True),
    Convention("positions look like centimetres", "in metres", _scaled(1e-2), unit=True),
    Convention("quaternions look like x y z w", "w x y z", lambda pose: pose[:, [0, 1, 2, 6, 3, 4, 5]]),
    Convention(
        "poses look like poses of the object in the hand's frame",
        "poses of the hand in the object's frame",
        lambda pose: pose_from_transform(inverse(transform_from_pose(pose))),
    ),
)
"""All other conventions, in the order in which they are undone."""


def convention_notes(scenes: Sequence[Scene]) -> tuple[str, ...]:
    """Notes on the conventions that a file most likely uses, where they clearly differ from the assumed ones.

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


def refuse_conventions(notes: Sequence[str], where: str = "the grasps") -> None:
    """Refuse grasps that are most likely in another convention.

    Args:
        notes: Notes of `convention_notes`.
        where: Grasps or file, for the message.

    Raises:
        ConventionError: there are notes.
    """
    if notes:
        raise ConventionError(f"{where}: {'; '.join(notes)}; `as_is` takes them as they are")


def joint_notes(hand: Hand, q: Float[np.ndarray, "N n"]) -> tuple[str, ...]:
    """Note that joint values look like degrees, if they do; values (N, n) in `hand.joint_names` order."""
    q = q[np.isfinite(q).all(axis=1)]
    if not _fits_degrees(hand, q, FULL_TURN_RAD):
        return ()
    within = [(_beyond(hand, values) <= LIMIT_TOLERANCE_RAD).sum() for values in (np.radians(q), q)]
    return (
        f"{DEGREES.looks}: as such, {within[0]} of {len(q)} grasps lie within the joint limits, as given {within[1]}; "
        f"they must be {DEGREES.needed}",
    )


def _fits_degrees(hand: Hand, q: np.ndarray, beyond_rad: float) -> bool:
    """Return whether joint values (N, n) lie within the limits as degrees, and by more than this beyond as radians."""
    if not q.size or not _hinges(hand).any():
        return False
    within = _beyond(hand, np.radians(q)) <= LIMIT_TOLERANCE_RAD
    return bool(np.mean(within & (_beyond(hand, q) > beyond_rad)) >= PLAUSIBLE_SHARE)


def _beyond(hand: Hand, q: np.ndarray) -> np.ndarray:
    """Return the largest distance (N,) of revolute joints beyond their limits, in radians."""
    hinge = _hinges(hand)
    return np.maximum(hand.lower[hinge] - q[:, hinge], q[:, hinge] - hand.upper[hinge]).max(axis=1)


def _hinges(hand: Hand) -> Bool[np.ndarray, " n"]:
    """Return a mask (n,) of the revolute joints."""
    return np.array([hand.joints_by_name[name].kind == "revolute" for name in hand.joint_names], dtype=bool)


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

    def apart(self, pose: Poses, q: np.ndarray) -> Float[np.ndarray, " N"]:
        """Distance (N,) of the second nearest finger plus the depth of the deepest link, in metres, as `NEAR_M`."""
        finger, link = self.distances(pose, q, 2.0 * FEW_FAR_M)
        return np.maximum(finger, 0.0) + np.maximum(-link, 0.0)


def _fingers(hand: Hand) -> list[np.ndarray]:
    """Columns of the contact links of each finger among the links with collision geometry."""
    links = links_of(hand)
    groups = np.array(link_groups(hand, links))
    touching = np.isin(links, [contact.link for contact in hand.contacts])
    return [np.flatnonzero((groups == name) & touching) for name in np.unique(groups[touching]) if name != PALM]


def _read(kinds: Sequence[Convention], pose: Poses, q: np.ndarray) -> tuple[Poses, np.ndarray]:
    """Return poses and joint values in our convention, of a file in others."""
    for kind in kinds:
        pose, q = kind.read(pose), kind.joints(q)
    return pose, q


def _pose_notes(hand: Hand, at: _Objects, pose: Poses, q: np.ndarray) -> tuple[str, ...]:
    """Note on the convention that poses look like, where they are not plausible."""
    # The poses of a hand with one finger show nothing.
    if len(_fingers(hand)) < 2 or ((as_read := at.apart(pose, q)) <= NEAR_M).mean() > IMPLAUSIBLE_SHARE:
        return ()
    apart = at.distances(pose, q, APART_M)[1] >= APART_M
    several = len(np.unique(pose.round(6), axis=0)) >= MIN_POSES
    usable = [
        kind
        for kind in CONVENTIONS
        if (kind is not DEGREES or _fits_degrees(hand, q, BEYOND_RAD))
        and (apart.mean() >= PLAUSIBLE_SHARE if kind.unit else several or (as_read >= FEW_FAR_M).all())
    ]
    readings = [
        kinds
        for count in (1, 2)
        for kinds in combinations(usable, count)
        if sum(kind.unit for kind in kinds) <= 1 and (several or count == 1)
    ]
    limits = [NEAR_M if several or kinds[0].unit else FEW_NEAR_M for kinds in readings]
    near = [(at.apart(*_read(kinds, pose, q)) <= limit).sum() for kinds, limit in zip(readings, limits, strict=True)]
    # Of equally good ones the simplest, which comes first.
    best = int(np.argmax(near)) if near else -1
    if best >= 0 and near[best] >= PLAUSIBLE_SHARE * len(pose):
        looks, needed = (" and ".join(getattr(kind, key) for kind in readings[best]) for key in ("looks", "needed"))
        return (
            f"{looks}: as such, two fingers come within {1e3 * limits[best]:.0f} mm of the object in {near[best]} of "
            f"{len(pose)} grasps, as given in {(as_read <= limits[best]).sum()}; they must be {needed}",
        )
    if apart.mean() < PLAUSIBLE_SHARE:
        return ()
    return (
        f"hand and object are far apart: in {apart.sum()} of {len(pose)} grasps no part of the hand comes within "
        f"{1e2 * APART_M:.0f} cm; poses must be of link '{hand.base_link}' in the object's frame, in metres",
    )
