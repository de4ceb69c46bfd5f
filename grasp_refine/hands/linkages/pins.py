"""Pins between links that only a coupling of joints keeps together, as in the linkages of grippers.

A URDF is a tree: the inner knuckle of a parallel gripper hangs from the base, and a mimic joint turns it so that its
end stays at the finger. There is a point of each that is the same in all states, and what is fixed to them is near.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, product

import numpy as np

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.array_types import Float
from grasp_refine.geometry.body import Body
from grasp_refine.hands.files.fingertips import branch_ends
from grasp_refine.hands.files.mimics import curves, mimic_map
from grasp_refine.hands.files.tree import Joint, LinkPair, joints_above, rigid_parts
from grasp_refine.hands.files.tree_poses import tree_poses

NUM_VALUES = 9
"""Number of values of the joint that moves both links, over its range."""

PIN_PLAY_M = 2e-4
"""Largest distance in metres between the points of a pin."""

MIN_TURN_RAD = 0.1
"""Least angle in radians by which two links turn about a pin."""

NEAR_M = 3e-3
"""Largest distance in metres between links that a pin may join, with a bush or a washer between them."""


def pinned_links(
    base_link: str, joints: Sequence[Joint], independent: Sequence[str], bodies: Mapping[str, Body]
) -> tuple[LinkPair, ...]:
    """Return the pairs of ends of branches that one joint moves, and that share a pin.

    Args:
        base_link: Link that the first joints hang from.
        joints: All joints, parents before children.
        independent: Names of the n independent joints.
        bodies: Link -> its collision geometry, of links with any.
    """
    leader = dict(zip(*_leaders(joints, independent), strict=True))
    ends = branch_ends(bodies, joints)
    ways = {end: {joint.name for joint in joints_above(end, joints) if joint.movable} for end in ends}
    pairs = []
    for a, b in combinations(ends, 2):
        drivers = {leader[name] for name in ways[a] | ways[b]}
        if ways[a] - ways[b] and ways[b] - ways[a] and len(drivers) == 1:
            T = _poses(base_link, joints, independent, *drivers)
            if _turn(T[a], T[b]) >= MIN_TURN_RAD and _play(T[a], T[b]) <= PIN_PLAY_M and _near(T, joints, bodies, a, b):
                pairs.append((a, b))
    return tuple(pairs)


def _leaders(joints: Sequence[Joint], independent: Sequence[str]) -> tuple[tuple[str, ...], list[str]]:
    """Names of the movable joints, and of the independent one that each follows."""
    matrix, _, movable = mimic_map(joints, independent)
    return movable, [independent[int(np.abs(row).argmax())] for row in matrix]


def _poses(
    base_link: str, joints: Sequence[Joint], independent: Sequence[str], driver: str
) -> dict[str, Float[np.ndarray, "K 4 4"]]:
    """Poses of all links over the range of an independent joint, a turn if it has none, with the others at 0."""
    (joint,) = (joint for joint in joints if joint.name == driver)
    q = np.zeros((NUM_VALUES, len(independent)))
    q[:, independent.index(driver)] = np.linspace(max(joint.lower, -np.pi), min(joint.upper, np.pi), NUM_VALUES)
    matrix, offset, movable = mimic_map(joints, independent)
    values = q @ matrix.T + offset + curves(joints, independent)(q)
    return tree_poses(base_link, joints, dict(zip(movable, values.T, strict=True)))


def _near(
    T: Mapping[str, Float[np.ndarray, "K 4 4"]], joints: Sequence[Joint], bodies: Mapping[str, Body], a: str, b: str
) -> bool:
    """Return True if the geometry fixed to two links stays close in all states."""
    part = rigid_parts(joints)
    pairs = list(product(*([name for name in bodies if part.get(name) == part[end]] for end in (a, b))))
    table = Pairs(tuple(bodies[one] for one, _ in pairs), tuple(bodies[other] for _, other in pairs))
    T_a, T_b = (np.stack([T[pair[side]] for pair in pairs], axis=1) for side in (0, 1))
    distance = query(table, T_a, T_b, cutoff=2 * NEAR_M).distance
    return bool((distance.min(axis=1) <= NEAR_M).all())


def _turn(T_a: Float[np.ndarray, "K 4 4"], T_b: Float[np.ndarray, "K 4 4"]) -> float:
    """Largest angle in radians by which a link turns in the frame of another from the first state on."""
    R = T_a[:, :3, :3].mT @ T_b[:, :3, :3]
    cosine = (np.trace(R[0].T @ R, axis1=1, axis2=2) - 1.0) / 2.0
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)).max())


def _play(T_a: Float[np.ndarray, "K 4 4"], T_b: Float[np.ndarray, "K 4 4"]) -> float:
    """Largest distance in metres between the points of two links that stay nearest to each other.

    The points p_a and p_b of the links' frames minimise the sum of |R_a p_a + t_a - R_b p_b - t_b|^2 over the states.
    """
    A = np.concatenate([T_a[:, :3, :3], -T_b[:, :3, :3]], axis=2).reshape(-1, 6)
    b = (T_b[:, :3, 3] - T_a[:, :3, 3]).reshape(-1)
    residual = A @ np.linalg.lstsq(A, b, rcond=1e-9)[0] - b
    return float(np.linalg.norm(residual.reshape(-1, 3), axis=1).max())
