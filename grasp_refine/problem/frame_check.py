"""Signs that the poses of a grasp file use another frame than the hand's base link: rotated, or a link.

A grasp *fits* when no link is deeper than `DEEP_M` in the object, and two fingers are within `NEAR_M` of it: jaws when
they are closed, the fingers of other hands as they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from grasp_refine.collision.query import query
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.se3 import distances, inverse, pose_from_transform, transform
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.jaws import Jaws, jaws_of
from grasp_refine.scene.convention_check import MIN_POSES, NEAR_M, PLAUSIBLE_SHARE
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

MAX_SAMPLES = 16
"""Most grasps of a file that are checked."""

DEEP_M = 0.005
"""Depth of a link in the object, metres, beyond which a grasp does not fit."""

MIN_GAIN = 0.4
"""Least share of the grasps that fit under another reading and not as read."""

CERTAIN_SHARE = 0.95
"""Share of grasps that fit from which on no further reading is tried."""

SAME_M, SAME_RAD = 1e-4, 1e-3
"""Distance and angle of two frames that are the same."""


@dataclass(frozen=True, eq=False)
class Reading:
    """A frame whose poses a file may give."""

    name: str
    """Description of the frame for people, such as "turned by 90 degrees about z"."""
    T_frame_base: Float[np.ndarray, "4 4"]
    """Pose (4, 4) of the hand's base link in it."""


def frame_notes(scenes: Sequence[Scene]) -> tuple[str, ...]:
    """Note on a reading of the poses of a file under which its grasps fit much better; none where they fit as read.

    Args:
        scenes: The grasps of one hand, as read, by object.
    """
    some = _sampled(scenes)
    poses = np.concatenate([pose_from_transform(scene.T_world_root) for scene in some] or [np.zeros((0, 7))])
    if len(np.unique(poses.round(6), axis=0)) < MIN_POSES or some[0].hand.arm is not None:
        return ()
    prepared, jaws = [HandObject.of(scene) for scene in some], jaws_of(some[0].hand)

    def examine(reading: Reading) -> tuple[Bool[np.ndarray, " M"], Float[np.ndarray, " M"]]:
        parts = []
        for scene, base in zip(some, prepared, strict=True):
            parts.append(_fits(replace(scene, T_world_root=scene.T_world_root @ reading.T_frame_base), base, jaws))
        fits, depth = (np.concatenate(part) for part in zip(*parts, strict=True))
        return fits, depth

    fits, depth = examine(Reading("", np.eye(4)))
    if fits.mean() > PLAUSIBLE_SHARE - MIN_GAIN:
        return ()
    best, most, its_depth = None, fits.mean(), depth
    for reading in _readings(some[0].hand):
        found, deep = examine(reading)
        # Of equally good ones the simplest, which comes first.
        if found.mean() > most:
            best, most, its_depth = reading, found.mean(), deep
        if most >= CERTAIN_SHARE:
            break
    if best is None or most < max(PLAUSIBLE_SHARE, fits.mean() + MIN_GAIN):
        return ()
    count = len(fits)

    def said(fit: int, deep: Float[np.ndarray, " M"]) -> str:
        inside = deep[deep > DEEP_M]
        penetrate = f", {len(inside)} penetrate by {1e3 * np.median(inside):.1f} mm" if len(inside) else ", 0 penetrate"
        return f"{fit} of {count} grasps fit the object{penetrate}"

    return (
        f"poses look like poses of another frame than link {some[0].hand.base_link}: as read, "
        f"{said(int(fits.sum()), depth)}; {best.name}, {said(round(most * count), its_depth)}: check the frame",
    )


def _sampled(scenes: Sequence[Scene]) -> list[Scene]:
    """Return some grasps of all scenes without targets, evenly drawn."""
    rows = [np.flatnonzero(scene.posed) for scene in scenes]
    number = np.repeat(np.arange(len(scenes)), [len(part) for part in rows])
    chosen = np.sort(np.random.default_rng(0).permutation(len(number))[:MAX_SAMPLES])
    row = np.concatenate(rows)[chosen] if len(chosen) else np.zeros(0, dtype=int)
    return [
        Scene(scenes[k].hand, scenes[k].object, scenes[k].T_world_root[at], scenes[k].q[at])
        for k in np.unique(number[chosen]).tolist()
        for at in [row[number[chosen] == k]]
    ]


def _fits(
    scene: Scene, prepared: HandObject, jaws: Jaws | None
) -> tuple[Bool[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Return whether grasps (N,) fit, and the depth (N,) of their deepest link, metres."""
    hand, links = scene.hand, scene.links

    def by_link(q: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N L"]:
        T = prepared.chain(scene.T_world_root, q).T_world_link
        witness = query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape))
        return np.where(witness.valid, witness.distance, np.inf)

    distance = by_link(scene.q)
    depth = np.maximum(-distance.min(axis=1), 0.0)
    if jaws is not None:
        distance = by_link(np.where(jaws.closed != jaws.opened, jaws.closed, scene.q))
    fingers = [
        distance[:, np.isin(links, [contact.link for contact in hand.contacts if contact.group == finger])].min(axis=1)
        for finger in hand.fingers
    ]
    second = np.sort(fingers, axis=0)[min(1, len(fingers) - 1)]
    return (depth <= DEEP_M) & (second <= NEAR_M), depth


def _readings(hand: Hand) -> Iterator[Reading]:
    """Yield other readings: the base link turned by right angles, links that are fixed to it, and the grasp's middle.

    The first are turns about z, in which conventions differ most.
    """
    still = np.eye(4)
    seen = [still]
    for R, name in _turns():
        yield Reading(name, transform(R, np.zeros(3)))
        seen.append(transform(R, np.zeros(3)))
    links = tuple(sorted(hand.fixed_to(hand.base_link) - {hand.base_link}))
    frames = dict(zip(links, Chain(hand, links)(still[None], hand.rest[None]).T_world_link[0], strict=True))
    readings = [(f"as poses of link {link}", T) for link, T in frames.items()]
    if (middle := _middle(hand)) is not None:
        origin = "with the origin between the fingers"
        readings += [(origin, transform(np.eye(3), middle))]
        readings += [(f"{origin}, {name}", transform(R, middle)) for R, name in _turns() if name.endswith("about z")]
    for name, T_base_frame in readings:
        T = inverse(T_base_frame)
        apart = [distances(T[None], other[None]) for other in seen]
        if all(moved[0] > SAME_M or turned[0] > SAME_RAD for moved, turned in apart):
            seen.append(T)
            yield Reading(name, T)


def _middle(hand: Hand) -> Float[np.ndarray, " 3"] | None:
    """Return the middle (3,) of the contact links at rest in the frame of the base link; None: there are none."""
    if not hand.contacts:
        return None
    links = tuple(contact.link for contact in hand.contacts)
    T = Chain(hand, links)(np.eye(4)[None], hand.rest[None]).T_world_link[0]
    points = [hand.links_by_name[link].solid.candidates.points.mean(axis=0) for link in links]
    return np.mean([T[:3, :3] @ point + T[:3, 3] for T, point in zip(T, points, strict=True)], axis=0)


def _turns() -> list[tuple[Float[np.ndarray, "3 3"], str]]:
    """Return the 23 rotations (3, 3) that take axes to axes, about z first, with names for people."""
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        R = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if np.linalg.det(R) > 0.0 and not np.array_equal(R, np.eye(3)):
            found.append((R, _turn_name(R)))
    # Rotations about one axis before others, quarter turns before half turns.
    return sorted(found, key=lambda turn: (not turn[1].endswith("about z"), -np.trace(turn[0]), turn[1]))


def _turn_name(R: Float[np.ndarray, "3 3"]) -> str:
    """Return the name of a rotation by right angles."""
    kept = np.flatnonzero(np.diag(R) == 1.0)
    angle = round(float(np.degrees(np.arccos((np.trace(R) - 1.0) / 2.0))))
    if len(kept) == 1:
        axis = int(kept[0])
        back = R[(axis + 2) % 3, (axis + 1) % 3] < 0.0
        return f"turned by {'-' if back else ''}{angle} degrees about {'xyz'[axis]}"
    columns = ["".join(("-" if column.min() < 0.0 else "", "xyz"[np.abs(column).argmax()])) for column in R.T]
    return f"with other axes (x, y, z of link are {', '.join(columns)} of the file)"
