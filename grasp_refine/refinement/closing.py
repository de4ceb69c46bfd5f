"""Closing of open hands: fingers close from where they are until they touch the object."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.errors import HandError
from grasp_refine.core.plurals import count_text
from grasp_refine.core.se3 import transform_points
from grasp_refine.forces.squeeze import CONTACTS
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from grasp_refine.sampling.closure_frame import closure_frame
from grasp_refine.scene.contact_selection import CONTACT_DISTANCE_M, PALM, link_groups
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene, links_of

NUM_STEPS = 128
"""Number of steps in which a joint goes from one limit to the other."""

NUM_HALVINGS = 6
"""Number of times that its step is halved where a finger would touch."""


@dataclass(frozen=True, eq=False)
class ClosedHands:
    """N grasps whose open hands were closed."""

    q: Float[np.ndarray, "N n"]
    """Joint values (N, n) at which the fingers touch; the scene's where a hand was not open."""
    moved_m: Float[np.ndarray, " N"]
    """Largest distance (N,) by which a contact link moved, metres; 0 where a hand was not open, NaN where no finger of
    an open one meets the object."""


def closing_notes(moved_m: Float[np.ndarray, " N"], jaws: bool) -> tuple[str, ...]:
    """Return notes on the hands that were closed first, and on open ones that close on nothing.

    Args:
        moved_m: Distances as of `ClosedHands`.
        jaws: Whether the hand has two fingers.
    """
    what, by = "jaws" if jaws else "fingers", 1e3 * moved_m[moved_m > 0.0]
    notes = []
    if len(by):
        least, most = f"{by.min():.1f}", f"{by.max():.1f}"
        span = least if least == most else f"{least} to {most}"
        notes.append(
            f"the {what} of {len(by)} of {count_text(len(moved_m), 'grasp')} are open: they were closed first, by "
            f"{span} mm, until they touch"
        )
    if missing := int(np.isnan(moved_m).sum()):
        notes.append(
            f"the {what} of {missing} of {count_text(len(moved_m), 'grasp')} are open, and closing them does not reach "
            "the object"
        )
    return tuple(notes)


def is_open(scene: Scene, prepared: HandObject) -> Bool[np.ndarray, " N"]:
    """Return True for grasps (N,) whose fingers have yet to arrive at the object.

    These are grasps of two fingers where one does not touch, and grasps of other hands where a squeeze would
    reach the object with fewer than two fingers, or with one and the palm.
    """
    hand, links = scene.hand, scene.links
    posed = scene.posed
    T = np.where(posed[:, None, None], scene.T_world_root, np.eye(4))
    T_link = prepared.chain(T, np.where(posed[:, None], scene.q, 0.0)).T_world_link
    witness = prepared.query(scene.number, T_link, cutoff=CONTACTS.cutoff(hand, links))
    near = CONTACTS.choose(hand, links, witness)
    if hand.has_two_fingers:
        near &= np.where(witness.valid, witness.distance, np.inf) <= CONTACT_DISTANCE_M
    groups = np.array(link_groups(hand, links))
    counted = [name for name in np.unique(groups) if name != PALM or not hand.has_two_fingers]
    return posed & (sum(near[:, groups == name].any(axis=1) for name in counted) < 2)


def close_hands(
    scene: Scene, prepared: HandObject, *, gap: float = 0.0, frozen: Bool[np.ndarray, " n"] | Literal[False] = False
) -> ClosedHands:
    """Close the open hands of a scene (`is_open`); the base link stays.

    All joints that bend fingers close together, each by an even share of its range, within their limits. A joint stops
    when a link that it moves touches the object; one that moves several fingers stops when the two nearest are, in the
    mean, as far from the surface as inside it: jaws that move together would push an object off their middle until
    both touch. Joints that reach their limit without that stay where they were.

    Args:
        scene: Hand, object and grasps; targets are ignored.
        prepared: Geometry of this hand and object.
        gap: Distance in metres from the object at which fingers stop; below 0: a depth.
        frozen: True (n,) for joints that stay where they are.
    """
    hand, q = scene.hand, scene.q.copy()
    rows = np.flatnonzero(is_open(scene, prepared))
    moved = np.zeros(len(q))
    closing = np.where(frozen, 0.0, _closing(hand)) if len(rows) else np.zeros(len(hand.rest))
    if not closing.any():
        return ClosedHands(q, moved)
    groups = np.array(link_groups(hand, links_of(hand)))
    own = np.stack([groups == finger for finger in hand.fingers])
    moves = prepared.chain.moves.T[:, None] & own
    cutoff = np.where(moves.any(axis=(0, 1)), np.inf, np.nan)
    number, T = scene.number[rows], scene.T_world_root[rows]

    def touches(at: Int[np.ndarray, " R"], q: Float[np.ndarray, "R n"], _: Any = None) -> Bool[np.ndarray, "R n"]:
        witness = prepared.query(number[at], prepared.chain(T[at], q).T_world_link, cutoff=cutoff)
        distance = np.where(witness.valid, witness.distance, np.inf)[:, None, None]
        by_finger = np.sort(np.where(moves, distance, np.inf).min(axis=3), axis=2)
        several = by_finger.shape[2] > 1 and np.isfinite(by_finger[..., 1])
        return np.where(several, by_finger[..., :2].mean(axis=2), by_finger[..., 0]) <= gap

    start = np.clip(q[rows], hand.lower, hand.upper)
    at_once = touches(np.arange(len(rows)), start)
    # A continuous joint turns once at most.
    span = np.where(np.isfinite(hand.upper - hand.lower), hand.upper - hand.lower, np.pi)
    step = np.where(at_once, 0.0, closing * span / NUM_STEPS)
    q[rows], stopped = step_until_stopped(start, step, touches, (hand.lower, hand.upper), NUM_STEPS)
    stopped |= at_once
    q[rows] = np.where(stopped, q[rows], scene.q[rows])
    moved[rows] = np.where(stopped.any(axis=1), _distance(hand, scene.q[rows], q[rows]), np.nan)
    return ClosedHands(q, moved)


def step_until_stopped(
    value: Float[np.ndarray, "N n"],
    step: Float[np.ndarray, "N n"],
    touches: Callable[[np.ndarray, np.ndarray, np.ndarray], Bool[np.ndarray, "R n"]],
    limits: tuple[Float[np.ndarray, " n"] | float, Float[np.ndarray, " n"] | float],
    num_steps: int,
) -> tuple[Float[np.ndarray, "N n"], Bool[np.ndarray, "N n"]]:
    """Return values (N, n) that were moved until each touches or reaches its limit, and True (N, n) where it touched.

    A value that would touch after its step stays, and halves its step, `NUM_HALVINGS` times.

    Args:
        value: First values.
        step: Their steps; 0 for values that stay.
        touches: Says which values (R, n) touch, of rows (R,) with these values and steps (R, n).
        limits: Lowest and highest values.
        num_steps: Number of steps from one limit to the other.
    """
    value, stopped, least = value.copy(), np.zeros(value.shape, dtype=bool), 0.5**NUM_HALVINGS * np.abs(step)
    step = step.copy()
    for _ in range(2 * num_steps + NUM_HALVINGS):
        rows = np.flatnonzero(step.any(axis=1))
        if not len(rows):
            break
        now, by = value[rows], step[rows]
        tried = np.clip(now + by, *limits)
        touching = touches(rows, tried, by) & (by != 0.0)
        stopped[rows] |= touching
        ended = (tried == now) & ~touching
        value[rows] = np.where(touching, now, tried)
        by = np.where(touching, 0.5 * by, by)
        step[rows] = np.where(ended | (np.abs(by) < least[rows]), 0.0, by)
    return value, stopped


def _closing(hand: Hand) -> Float[np.ndarray, " n"]:
    """Return the direction (n,) in which each joint closes the hand, 1 or -1; 0 for others."""
    try:
        return np.where(hand.arm_joints, 0.0, closure_frame(hand).closing)
    except HandError:
        # No joint moves a finger.
        return np.zeros(len(hand.rest))


def _distance(hand: Hand, before: Float[np.ndarray, "N n"], after: Float[np.ndarray, "N n"]) -> Float[np.ndarray, " N"]:
    """Return the largest distance (N,) by which the middle of a contact link moves with the joints, metres."""
    links = [contact.link for contact in hand.contacts]
    middle = np.array([hand.links_by_name[link].solid.candidates.points.mean(axis=0) for link in links])
    chain, root = Chain(hand, links), np.tile(np.eye(4), (len(before), 1, 1))
    points = [transform_points(chain(root, q).T_world_link, middle) for q in (before, after)]
    return np.linalg.norm(points[1] - points[0], axis=-1).max(axis=1)
