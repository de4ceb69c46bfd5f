"""Joint values of a hand from another one: each finger as far bent and spread as the finger whose place it takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.hands.files.tree import joints_above
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.kept import kept
from grasp_refine.transfers.hand_frame import HandFrame


@dataclass(frozen=True)
class FingerJoints:
    """Independent joints of a finger that no other finger moves by, as indices, from the palm on."""

    bending: tuple[int, ...]
    """Joints that close it."""
    spreading: tuple[int, ...]
    """Joints that spread or oppose it."""


@kept
def finger_joints(hand: Hand) -> tuple[FingerJoints, ...]:
    """Return the joints of each finger of a hand, in the order of `HandFrame.fingers`."""
    frame = HandFrame.of(hand)
    matrix, _, movable = hand.mimic_map()
    leads = {name: np.flatnonzero(row) for name, row in zip(movable, matrix, strict=True)}
    of_finger: dict[str, list[int]] = {}
    for contact in hand.contacts:
        above = [joint.name for joint in joints_above(contact.link, hand.joints) if joint.movable]
        found = [int(k) for name in reversed(above) for k in leads[name]]
        of_finger.setdefault(contact.group, list(dict.fromkeys(found)))
    shared = {k for one in of_finger.values() for k in one if sum(k in other for other in of_finger.values()) > 1}
    alone = len(of_finger) > 1 and not all(set(one) <= shared for one in of_finger.values())
    joints = []
    for finger in frame.fingers:
        own = [k for k in of_finger[finger] if not (alone and k in shared)]
        closes = frame.closure.closing != 0
        joints.append(FingerJoints(tuple(k for k in own if closes[k]), tuple(k for k in own if not closes[k])))
    return tuple(joints)


def copied_joints(
    source: Hand, q: Float[np.ndarray, "M s"], hand: Hand, taken: Int[np.ndarray, "M k"]
) -> Float[np.ndarray, "M n"]:
    """Return joint values (M, n) that bend and spread each finger as far as the finger whose place it takes.

    A joint takes the share of its range that the joint at its place in the other finger has, from the palm on; further
    joints that of the last. Other joints are as in `HandFrame.q`.

    Args:
        source: The other hand.
        q: Its joint values (M, s).
        hand: The hand.
        taken: Fingers (M, k) of the other hand, as `Matching.taken`.
    """
    ours, theirs = HandFrame.of(hand), HandFrame.of(source)
    found = np.tile(ours.q, (len(q), 1))
    for k, own in enumerate(finger_joints(hand)):
        for f, other in enumerate(finger_joints(source)):
            rows = np.flatnonzero(taken[:, k] == f)
            for kind in ("bending", "spreading"):
                mine, its = getattr(own, kind), getattr(other, kind)
                for place, joint in enumerate(mine if its and len(rows) else ()):
                    at = its[min(place, len(its) - 1)]
                    share = _closed_share(theirs, q[rows, at], at)
                    found[rows, joint] = _at_share(ours, share, joint)
    return np.clip(found, hand.lower, hand.upper)


def _closed_share(frame: HandFrame, value: Float[np.ndarray, " M"], joint: int) -> Float[np.ndarray, " M"]:
    """Return the share (M,) of the range of a joint, from open to closed, or from its lower limit on."""
    lower, upper = frame.closure.lower[joint], frame.closure.upper[joint]
    share = (value - lower) / max(upper - lower, 1e-12)
    return 1.0 - share if frame.closure.closing[joint] < 0 else share


def _at_share(frame: HandFrame, share: Float[np.ndarray, " M"], joint: int) -> Float[np.ndarray, " M"]:
    """Return the values (M,) of a joint at a share of its range."""
    lower, upper = frame.closure.lower[joint], frame.closure.upper[joint]
    share = 1.0 - share if frame.closure.closing[joint] < 0 else share
    return lower + share * (upper - lower)
