"""Frame of any hand, by its geometry: its thumb, the order of its other fingers, its palm and its size."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from grasp_refine.collision.culling import bounding_sphere
from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import transform_points
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.files.finger_names import finger_names
from grasp_refine.hands.files.tree import joints_above
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.kept import kept
from grasp_refine.sampling.closure_frame import ClosureFrame, closure_frame

CLOSED_SHARES = (0.25, 0.4, 0.55)
"""Shares of the range of the closing joints at which fingers are compared."""

DRAWS = 64
"""Number of positions of the joints that spread or oppose fingers at which the thumb is looked for."""

TIE_MARGIN = 0.1
"""Difference of cosines up to which fingers oppose the others equally well."""

SPREAD_COST = 0.5
"""Cosine that the other fingers' spreading over their whole ranges costs."""

MIN_SIDE_SHARE = 0.1
"""Distance of the thumb from the middle of the other fingers, as a share of their breadth, below which it is at no
side of them, as in grippers."""


ThumbPlace = Literal["side", "middle", "none"]
"""Place of the thumb: at one side of the other fingers; before their middle, so that their order may as well be
reversed; or none, as in grippers with two fingers, either of which may be the thumb."""


@dataclass(frozen=True, eq=False)
class HandFrame:
    """Frame of a hand with k fingers and n independent joints, in the frame of its base link.

    The hand is seen with its thumb opposed to the other fingers, and half closed.
    """

    fingers: tuple[str, ...]
    """Fingers (`Hand.fingers`): the thumb, then the others from the thumb's side on."""
    center: Float[np.ndarray, " 3"]
    """Centre (3,) between the fingertips, where objects are held, metres."""
    axes: Float[np.ndarray, "3 3"]
    """Unit vectors as columns: from the thumb across to the others; along these, from the thumb's side on; and the
    approach, from the palm to the centre. Right-handed for right hands, left-handed for left hands."""
    thumb: ThumbPlace
    """Place of the thumb."""
    q: Float[np.ndarray, " n"]
    """Joint values (n,) with the thumb opposed and fingers half closed."""
    closure: ClosureFrame
    """Closing motion of the hand from its rest pose."""

    @property
    def is_left(self) -> bool:
        """Whether it is a left hand; never, where the thumb is at no side."""
        return self.thumb == "side" and bool(np.linalg.det(self.axes) < 0.0)

    @staticmethod
    @kept
    def of(hand: Hand) -> HandFrame:
        """Return the frame of a hand.

        The thumb is the finger that can close against all others: for some position of the joints that spread fingers,
        the direction in which its tip closes is opposed to the directions of all other tips. Of
        several such fingers it is the one by name, else the one with fewest of these joints, as in grippers with a
        finger that faces two others.

        Raises:
            HandError: no joint of the hand moves a link that is meant to touch.
        """
        closure, paths = closure_frame(hand), _paths(hand)
        names = tuple(paths)
        spread = _spread_draws(hand, closure)
        least = _agreement(hand, names, closure, spread).min(axis=0)
        called = np.array([name == "thumb" for name in finger_names(list(paths.values()))])
        spreads = np.array([sum(_spreads(hand, closure, path)) for path in paths.values()])
        tied = np.flatnonzero(least <= least.min() + TIE_MARGIN)
        thumb = int(tied[np.lexsort((least[tied], spreads[tied], ~called[tied]))[0]])
        # Other fingers spread only where the thumb opposes them better so.
        own = np.array([name in paths[names[thumb]] for name in hand.joint_names])
        spread = np.concatenate([np.where(own, spread, hand.rest), spread])
        opposed = _agreement(hand, names, closure, spread)[:, thumb]
        away = np.abs(spread - hand.rest) / np.maximum(closure.upper - closure.lower, 1e-9)
        draw = int((opposed + SPREAD_COST * np.where(own, 0.0, away).max(axis=1)).argmin())
        q = _closed(closure, spread[draw : draw + 1], 0.5)[0]
        return _framed(replace(hand, rest=np.clip(q, hand.lower, hand.upper)), closure, names, thumb)


def _agreement(
    hand: Hand, names: tuple[str, ...], closure: ClosureFrame, spread: Float[np.ndarray, "D n"]
) -> Float[np.ndarray, "D k"]:
    """Return the largest cosine (D, k) between the direction in which a tip closes and those of the others."""
    # The same share of all fingers at once.
    shares = [_tip_motion(hand, names, closure, _closed(closure, spread, share)) for share in CLOSED_SHARES]
    cosine = np.mean([motion @ motion.mT for motion in shares], axis=0)
    own = np.arange(len(names))
    cosine[:, own, own] = -1.0
    return cosine.max(axis=2)


def _framed(hand: Hand, closing: ClosureFrame, names: tuple[str, ...], thumb: int) -> HandFrame:
    """Return the frame of a hand whose rest pose has the thumb opposed; its joints close as `closing` says."""
    closure = closure_frame(hand)
    others = [k for k in range(len(names)) if k != thumb]
    tips, knuckles = _tips(hand, names, hand.rest[None])[0], _knuckles(hand, names, closing)
    approach = closure.approach
    if len(others) > 1:
        centred = knuckles[others] - knuckles[others].mean(axis=0)
        along = np.linalg.svd(centred)[2][0]
        approach = _unit(approach - (approach @ along) * along)
        across = np.cross(along, approach)
        # The thumb closes towards the others.
        motion = _tip_motion(hand, names, closing, hand.rest[None])[0]
        across = across * (1.0 if (motion[thumb] - motion[others].mean(axis=0)) @ across > 0.0 else -1.0)
    else:
        between = tips[others[0]] - tips[thumb] if others else closure.across
        across = _unit(between - (between @ approach) * approach)
    along = np.cross(approach, across)
    at = knuckles @ along
    side, breadth = (at[thumb] - at[others].mean(), np.ptp(at[others])) if len(others) > 1 else (0.0, 0.0)
    one_sided = abs(side) > MIN_SIDE_SHARE * breadth
    if one_sided and side > 0.0:
        along, at = -along, -at
    return HandFrame(
        fingers=tuple(names[k] for k in (thumb, *sorted(others, key=lambda k: at[k]))),
        center=closure.center,
        axes=np.column_stack([across, along, approach]),
        thumb="none" if len(others) < 2 else "side" if one_sided else "middle",
        q=hand.rest,
        closure=closing,
    )


def _unit(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Return the unit vector (3,) along a vector."""
    return vector / np.linalg.norm(vector)


def _paths(hand: Hand) -> dict[str, list[str]]:
    """Return the names of links and joints of each finger, from its tip on."""
    paths: dict[str, list[str]] = {}
    for contact in hand.contacts:
        above = joints_above(contact.link, hand.joints)
        paths.setdefault(contact.group, [name for joint in above for name in (joint.child, joint.name)])
    return paths


def _spreads(hand: Hand, closure: ClosureFrame, path: list[str]) -> list[bool]:
    """Return for each link or joint of a finger whether it is a joint that spreads or opposes it."""
    return [name in hand.joint_names and bool(closure.spreading[hand.joint_names.index(name)]) for name in path]


def _spread_draws(hand: Hand, closure: ClosureFrame) -> Float[np.ndarray, "D n"]:
    """Return joint values (D, n): at rest, and with joints that spread or oppose fingers anywhere in their ranges."""
    share = np.random.default_rng(0).uniform(0.0, 1.0, (DRAWS, len(hand.rest)))
    drawn = closure.lower + share * (closure.upper - closure.lower)
    return np.concatenate([hand.rest[None], np.where(closure.spreading, drawn, hand.rest)])


def _closed(closure: ClosureFrame, q: Float[np.ndarray, "D n"], share: float) -> Float[np.ndarray, "D n"]:
    """Return joint values (D, n) with closing joints at a share of their ranges, 0 open and 1 closed."""
    closed = np.where(closure.closing > 0, closure.upper, closure.lower)
    return np.where(closure.closing == 0, q, closure.opened + share * (closed - closure.opened))


def _tips(hand: Hand, names: tuple[str, ...], q: Float[np.ndarray, "D n"]) -> Float[np.ndarray, "D k 3"]:
    """Return the middle (D, k, 3) of the contacts of each finger in the base frame, metres."""
    T = Chain(hand, [contact.link for contact in hand.contacts])(np.tile(np.eye(4), (len(q), 1, 1)), q).T_world_link
    points = transform_points(T, np.array([pad_point(hand, i) for i in range(len(hand.contacts))]))
    return np.stack(
        [points[:, [c.group == name for c in hand.contacts]].mean(axis=1) for name in names],
        axis=1,
    )


def pad_point(hand: Hand, index: int) -> Float[np.ndarray, " 3"]:
    """Return the point (3,) of a contact in its link's frame; without one, the middle of the link."""
    contact = hand.contacts[index]
    if contact.point is not None:
        return np.array(contact.point)
    return np.asarray(bounding_sphere(hand.links_by_name[contact.link].solid)[:3])


def _tip_motion(
    hand: Hand, names: tuple[str, ...], closure: ClosureFrame, q: Float[np.ndarray, "D n"]
) -> Float[np.ndarray, "D k 3"]:
    """Return the unit directions (D, k, 3) in which the tips move as the hand closes."""
    step = 1e-4 * closure.closing * hand.per_radian
    moved = _tips(hand, names, q + step) - _tips(hand, names, q - step)
    return moved / np.maximum(np.linalg.norm(moved, axis=-1, keepdims=True), 1e-12)


def _knuckles(hand: Hand, names: tuple[str, ...], closure: ClosureFrame) -> Float[np.ndarray, "k 3"]:
    """Return the origin (k, 3) of the first joint that closes each finger, base frame, metres.

    Joints that carry a knuckle in the palm, as of a little finger, are before it.
    """
    matrix, _, movable = hand.mimic_map()
    closes = dict(zip(movable, (matrix[:, closure.closing != 0] != 0.0).any(axis=1), strict=True))
    first: dict[str, str] = {}
    for contact in hand.contacts:
        above = [joint for joint in joints_above(contact.link, hand.joints) if closes.get(joint.name)]
        first.setdefault(contact.group, above[-1].child if above else hand.base_link)
    return Chain(hand, [first[name] for name in names])(np.eye(4)[None], hand.rest[None]).T_world_link[0, :, :3, 3]
