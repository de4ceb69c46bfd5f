"""Transfer of grasps to a hand: fingers are matched, the hand is placed, and the best of several placements is kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.core.array_records import choose, join, take
from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.se3 import transform
from grasp_refine.hands.hand import Hand
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.original import Original
from grasp_refine.transfers.hand_frame import HandFrame
from grasp_refine.transfers.joint_copy import copied_joints
from grasp_refine.transfers.matching import Matching, matchings
from grasp_refine.transfers.placement import Obstacle, Pads, Placed, Wishes, place
from grasp_refine.transfers.source_grasps import SourceGrasps, finger_contacts

CLEARED = 3
"""Number of attempts at each grasp that are moved out of the object."""

REACHED_M = 0.015
"""Distance in metres from a contact up to which a finger is sent there; farther ones touch where they can."""

KEPT_M = 1e-4
"""Distance in metres between the contacts of two hands up to which they are one and the same."""

MATCHING_M = 0.01
"""Distance in metres that a matching of cost 1 counts as much as."""


@dataclass(frozen=True, eq=False)
class Transferred:
    """N grasps of a hand that take the place of grasps of another one."""

    T: Float[np.ndarray, "N 4 4"]
    """Poses (N, 4, 4) of the base link, object frame."""
    q: Float[np.ndarray, "N n"]
    """Joint values (N, n)."""
    original: Original
    """Contacts that the fingers take over."""
    target_link: Float[np.ndarray, "N L 3"]
    """Points (N, L, 3) on the thumb and on the finger that presses against it which should touch, link frames, metres,
    as `Scene.target_link`; NaN for others, where they are out of reach, and for jaws, which close as one."""
    target_object: Float[np.ndarray, "N L 3"]
    """Points (N, L, 3) on the object where they should, object frame, metres."""


Joints = tuple[Hand, Float[np.ndarray, "N s"]]
"""Hand of a source, and its joint values (N, s)."""

Place = Callable[[SourceGrasps, HandObject, Int[np.ndarray, " N"], Joints | None], Transferred]
"""Way to bring grasps to a hand, such as `transfer_grasps`, of the same arguments."""


def copied_grasps(
    source: SourceGrasps,
    prepared: HandObject,
    number: Int[np.ndarray, " N"],
    joints: Joints | None = None,
) -> Transferred:
    """Return grasps of a hand that is laid over the hand of a source, with its joints copied finger by finger.

    They know nothing of the object, and are what transfers are compared with. Arguments are as of `transfer_grasps`.
    """
    hand, frame = prepared.hand, HandFrame.of(prepared.hand)
    members = _members(source, frame)
    members = take(members, _cheapest(members, np.zeros(len(members.row)), 1))
    wishes = members.wishes(source, frame)
    copied = wishes.q if joints is None else copied_joints(joints[0], joints[1], hand, members.postures(source))
    none = np.full((2, len(source), len(prepared.chain.links), 3), np.nan)
    return Transferred(wishes.T, copied, original_of(source, hand, members.taken), *none)


def transfer_grasps(
    source: SourceGrasps,
    prepared: HandObject,
    number: Int[np.ndarray, " N"],
    joints: Joints | None = None,
) -> Transferred:
    """Return grasps of a hand whose fingers touch where the fingers of a source do, and whose palm is near its palm.

    Each matching of fingers is tried from the joint values of `HandFrame.q` and, where they are known, from those of
    the source (`copied_joints`); the `CLEARED` best of each grasp are moved out of the object, and the best one is
    kept. A hand that touches as the source does with copied joints is not moved at all.

    Args:
        source: N grasps.
        prepared: The hand, and the objects.
        number: Index (N,) of each grasp's object.
        joints: Hand of the source and its joint values (N, s); None: not known.

    Raises:
        HandError: no joint of the hand moves a link that is meant to touch.
    """
    hand = prepared.hand
    members = _members(source, HandFrame.of(hand))
    wishes = members.wishes(source, HandFrame.of(hand))
    copied = (
        None if joints is None else copied_joints(joints[0], joints[1][members.row], hand, members.postures(source))
    )
    if copied is not None:
        members, wishes = join(members, members), join(wishes, replace(wishes, q=copied))
    kept = _touches_alike(prepared, number[members.row], wishes)
    placed = place(hand, wishes)
    placed = choose(kept, Placed(wishes.T, wishes.q, np.zeros(len(kept))), placed)
    some = _cheapest(members, placed.cost, CLEARED)
    members, wishes, placed = take(members, some), take(wishes, some), take(placed, some)
    cleared = place(hand, wishes, placed, Obstacle(prepared, number[members.row]))
    placed = choose(kept[some], placed, cleared)
    best = _cheapest(members, placed.cost, 1)
    members, placed = take(members, best), take(placed, best)
    original = original_of(source, hand, members.taken)
    return Transferred(placed.T, placed.q, original, *_targets(prepared, placed, original))


def _touches_alike(prepared: HandObject, number: Int[np.ndarray, " M"], wishes: Wishes) -> Bool[np.ndarray, " M"]:
    """Return a mask (M,) of wishes whose poses and joint values fulfil them: all fingers touch there, no other does."""
    point, _, _ = finger_contacts(prepared, number, wishes.T, wishes.q)
    away = np.linalg.norm(point - wishes.point, axis=-1)
    alike = np.isnan(point[..., 0]) == np.isnan(wishes.point[..., 0])
    return np.asarray((alike & ~(away > KEPT_M)).all(axis=1))


@dataclass(frozen=True, eq=False)
class Members:
    """M attempts at grasps."""

    row: Int[np.ndarray, " M"]
    """Grasp (M,) of the source."""
    taken: Int[np.ndarray, "M k"]
    """Fingers (M, k) as `Matching.taken`."""
    turned: Bool[np.ndarray, " M"]
    """As `Matching.turned`."""
    cost: Float[np.ndarray, " M"]
    """Cost (M,) of the matching, m^2."""

    def wishes(self, source: SourceGrasps, frame: HandFrame) -> Wishes:
        """Return the wishes of the attempts: contacts of the source, and the frame of the hand laid over that of it."""
        has, at = self.taken >= 0, (self.row[:, None], np.maximum(self.taken, 0))
        point, normal = (np.where(has[..., None], each[at], np.nan) for each in (source.point, source.normal))
        theirs, ours = _right_handed(source.axes[self.row]), np.tile(_right_handed(frame.axes), (len(self.row), 1, 1))
        ours[self.turned, :, :2] *= -1.0
        R = theirs @ ours.mT
        T = transform(R, source.center[self.row] - R @ frame.center)
        return Wishes(point, normal, np.where(has, source.weight[at], 0.0), T, np.tile(frame.q, (len(T), 1)))

    def postures(self, source: SourceGrasps) -> Int[np.ndarray, "M k"]:
        """Return `taken`, and for fingers without a contact the finger of the source at their place, if it has none."""
        place = np.arange(self.taken.shape[1])
        used = (self.taken[:, :, None] == place).any(axis=1)
        free = (self.taken < 0) & ~used & (place < len(source.fingers))
        return np.where(free, place, self.taken)


def _members(source: SourceGrasps, frame: HandFrame) -> Members:
    """Return an attempt for each matching of each grasp."""
    known: dict[tuple[tuple[bool, ...], bool], list[Matching]] = {}
    found: list[tuple[int, Matching]] = []
    for row, (touching, left) in enumerate(zip(source.touching.tolist(), source.is_left.tolist(), strict=True)):
        key = tuple(touching), left == frame.is_left
        if key not in known:
            known[key] = matchings(source, frame, key[0], same_side=key[1])
        found += [(row, each) for each in known[key]]
    return Members(
        row=np.array([row for row, _ in found], dtype=np.int64),
        taken=np.array([each.taken for _, each in found], dtype=np.int64).reshape(-1, len(frame.fingers)),
        turned=np.array([each.turned for _, each in found], dtype=bool),
        cost=MATCHING_M**2 * np.array([each.cost for _, each in found]),
    )


def _right_handed(axes: np.ndarray) -> np.ndarray:
    """Return axes (..., 3, 3) of hands whose second one makes them a rotation."""
    across, approach = axes[..., 0], axes[..., 2]
    return np.stack([across, np.cross(approach, across), approach], axis=-1)


def _cheapest(members: Members, cost: Float[np.ndarray, " M"], most: int) -> Int[np.ndarray, " K"]:
    """Return the cheapest attempts (K,), up to `most` of each grasp, by grasp."""
    order = np.lexsort((cost + members.cost, members.row))
    row = members.row[order]
    return order[np.arange(len(row)) - np.searchsorted(row, row) < most]


def _targets(
    prepared: HandObject, placed: Placed, original: Original
) -> tuple[Float[np.ndarray, "N L 3"], Float[np.ndarray, "N L 3"]]:
    """Return `target_link` and `target_object` of placed grasps."""
    hand, links = prepared.hand, prepared.chain.links
    on_link, on_object = np.full((2, len(placed.q), len(links), 3), np.nan)
    pads, frame = Pads.of(hand), HandFrame.of(hand)
    points = pads.points(hand, placed.T, placed.q)
    for k, finger in enumerate(hand.fingers if not hand.has_two_fingers else ()):
        at = frame.fingers.index(finger)
        away = np.linalg.norm(points[:, at] - original.point[:, k, None], axis=-1)
        rows = np.flatnonzero(original.opposed[:, k] & (away.min(axis=1) <= REACHED_M))
        best = away[rows].argmin(axis=1)
        columns = np.array([links.index(link) for link in pads.links])[pads.link[at, best]]
        on_link[rows, columns], on_object[rows, columns] = pads.point[at, best], original.point[rows, k]
    return on_link, on_object


def original_of(source: SourceGrasps, hand: Hand, taken: np.ndarray) -> Original:
    """Return the original of N grasps of a hand, whose fingers take the places of others (N, k)."""
    frame = HandFrame.of(hand)
    taken = taken[:, [frame.fingers.index(finger) for finger in hand.fingers]]
    rows, has = np.arange(len(source))[:, None], taken >= 0
    at = rows, np.maximum(taken, 0)
    names = np.array(source.fingers)
    point, normal = (np.where(has[..., None], each[at], np.nan) for each in (source.point, source.normal))
    lost = [
        ", ".join(names[k] for k in np.flatnonzero(touch) if k not in some)
        for touch, some in zip(source.touching, taken.tolist(), strict=True)
    ]
    return Original(
        point=point,
        normal=normal,
        finger=np.where(has, names[np.maximum(taken, 0)], ""),
        dropped=np.array(lost, dtype=str),
        opposed=_opposed(normal, taken == 0),
        approach=source.axes[..., 2],
        own_approach=np.tile(frame.axes[:, 2], (len(source), 1)),
    )


def _opposed(normal: np.ndarray, thumb: np.ndarray) -> np.ndarray:
    """Return a mask (N, k) of the thumb, where it touches (N, k), and of the finger that presses against it most.

    `normal` (N, k, 3) are those of the object at the fingers' places.
    """
    of_thumb = np.nansum(np.where(thumb[..., None], normal, np.nan), axis=1)
    against = np.where(
        thumb | np.isnan(normal[..., 0]), np.inf, np.einsum("nk,nfk->nf", of_thumb, np.nan_to_num(normal))
    )
    known = thumb.any(axis=1) & np.isfinite(against).any(axis=1)
    found = thumb & ~np.isnan(normal[..., 0])
    found[known, against[known].argmin(axis=1)] = True
    return found
