"""Matching of fingers: which finger of a hand takes the place of which finger of another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, product

from grasp_refine.transfers.hand_frame import HandFrame
from grasp_refine.transfers.source_grasps import SourceGrasps

MAX_MATCHINGS = 8
"""Largest number of matchings that are tried for a grasp, the likeliest first."""

SHIFT_COST = 0.15
"""Cost of a finger that takes the place of one that comes earlier or later in the other hand, by one place."""


@dataclass(frozen=True)
class Matching:
    """Fingers of a hand with k fingers, each with the finger of another hand in whose place it is."""

    taken: tuple[int, ...]
    """Indices (k,) among `SourceGrasps.fingers` in the order of `HandFrame.fingers`; -1: none."""
    turned: bool
    """Whether the hand is turned by half a turn about its approach, so that its thumb is on the other side."""
    cost: float
    """Cost of fingers in other places than their own, without unit."""


def matchings(source: SourceGrasps, frame: HandFrame, touching: tuple[bool, ...], *, same_side: bool) -> list[Matching]:
    """Return the matchings of the fingers of a source that touch with the fingers of a hand, the likeliest first.

    The thumb takes the place of the thumb. The others keep their order from the thumb's side on; where one of the hands
    has no such side, or they are a left and a right one, it may be reversed. Where too few fingers are there, some
    are dropped; where there are more, some are free.

    Args:
        source: The grasps.
        frame: Frame of the hand.
        touching: Whether each finger of the source touches.
        same_side: Whether both are right hands, or both left hands.
    """
    symmetric = not (same_side and source.thumb == frame.thumb == "side")
    found = {each.taken + (each.turned,): each for each in _all(source, frame, touching, symmetric)}
    return sorted(found.values(), key=lambda each: each.cost)[:MAX_MATCHINGS]


def _all(source: SourceGrasps, frame: HandFrame, touching: tuple[bool, ...], symmetric: bool) -> Iterator[Matching]:
    """Yield the matchings, in any order."""
    count, fingers = len(touching), len(frame.fingers)
    # Without a thumb, either finger of a gripper may be it.
    thumbs = range(count) if source.thumb == "none" and count == 2 else (0,)
    own_thumbs = range(fingers) if frame.thumb == "none" and fingers == 2 else (0,)
    for thumb, own in product(thumbs, own_thumbs):
        others = [k for k in range(count) if k != thumb]
        places = [k for k in range(fingers) if k != own]
        touch = [k for k in others if touching[k]]
        both = min(len(touch), len(places))
        for some, where in product(combinations(touch, both), combinations(places, both)):
            for reverse in (False, True) if symmetric else (False,):
                taken = [-1] * fingers
                taken[own] = thumb if touching[thumb] else -1
                cost = 0.0
                for finger, place in zip(some, reversed(where) if reverse else where, strict=True):
                    taken[place] = finger
                    cost += SHIFT_COST * abs(_rank(finger, others) - _rank(place, places)) * (not reverse)
                turned = (own != 0) != (thumb != 0)
                yield Matching(tuple(taken), turned, cost)


def _rank(finger: int, fingers: list[int]) -> int:
    """Return the place of a finger among others."""
    return fingers.index(finger)
