"""Pins between links that only a coupling of joints keeps together, as in the linkages of grippers.

A URDF is a tree: the inner knuckle of a parallel gripper hangs from the base, and a mimic joint turns it so that its
end stays at the finger. There is a point of each that is the same in all states, and what is fixed to them is near.
"""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
from jaxtyping import Float

from grasp_refine.hands.chain import Chain
from grasp_refine.hands.fingertips import branch_ends, rigid_parts
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.self_collision import joint_ranges, link_distances
from grasp_refine.hands.tree import LinkPair

NUM_VALUES = 9
"""Number of values of the joint that moves both links, over its range."""

PIN_PLAY_M = 2e-4
"""Largest distance in metres between the points of a pin."""

MIN_TURN_RAD = 0.1
"""Least angle in radians by which two links turn about a pin."""

NEAR_M = 3e-3
"""Largest distance in metres between links that a pin may join, with a bush or a washer between them."""


def pinned_links(hand: Hand) -> tuple[LinkPair, ...]:
    """Return the pairs of ends of branches that one joint moves, and that share a pin."""
    links = branch_ends([link.name for link in hand.links if link.body is not None], hand.joints)
    matrix, _, movable = hand.mimic_map()
    row = {name: i for i, name in enumerate(movable)}
    drivers = {}
    for link in links:
        above = {joint.name for joint in hand.joints_to([link]) if joint.movable}
        drivers[link] = above, {int(i) for name in above for i in np.flatnonzero(matrix[row[name]])}
    pairs = []
    for a, b in combinations(links, 2):
        (joints_a, by_a), (joints_b, by_b) = drivers[a], drivers[b]
        apart = joints_a - joints_b and joints_b - joints_a
        if apart and len(by_a) == 1 and by_a == by_b and _share_pin(hand, (a, b), *by_a):
            pairs.append((a, b))
    return tuple(pairs)


def _share_pin(hand: Hand, pair: LinkPair, driver: int) -> bool:
    """Return True if two links share a pin over the range of an independent joint."""
    q = np.tile(hand.rest, (NUM_VALUES, 1))
    lower, upper = joint_ranges(hand)
    q[:, driver] = np.linspace(lower[driver], upper[driver], NUM_VALUES)
    T_a, T_b = np.moveaxis(Chain(hand, pair)(np.broadcast_to(np.eye(4), (NUM_VALUES, 4, 4)), q).T_world_link, 1, 0)
    if _turn(T_a, T_b) < MIN_TURN_RAD or _play(T_a, T_b) > PIN_PLAY_M:
        return False
    part = rigid_parts(hand.joints)
    solid = [link.name for link in hand.links if link.body is not None]
    first, second = ([name for name in solid if part.get(name) == part[end]] for end in pair)
    distance = link_distances(hand, list(product(first, second)), q, cutoff=2 * NEAR_M)
    return bool((distance.min(axis=1) <= NEAR_M).all())


def _turn(T_a: Float[np.ndarray, "K 4 4"], T_b: Float[np.ndarray, "K 4 4"]) -> float:
    """Largest angle in radians by which a link turns in the frame of another from the first state on."""
    R = T_a[:, :3, :3].mT @ T_b[:, :3, :3]
    cosine = (np.trace(R[0].T @ R, axis1=1, axis2=2) - 1.0) / 2.0
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)).max())


def _play(T_a: Float[np.ndarray, "K 4 4"], T_b: Float[np.ndarray, "K 4 4"]) -> float:
    """Largest distance in metres between a point of one link and one of the other, those that stay nearest.

    The points p_a and p_b of the links' frames minimise the sum of |R_a p_a + t_a - R_b p_b - t_b|^2 over the states.
    """
    A = np.concatenate([T_a[:, :3, :3], -T_b[:, :3, :3]], axis=2).reshape(-1, 6)
    b = (T_b[:, :3, 3] - T_a[:, :3, 3]).reshape(-1)
    residual = A @ np.linalg.lstsq(A, b, rcond=1e-9)[0] - b
    return float(np.linalg.norm(residual.reshape(-1, 3), axis=1).max())
