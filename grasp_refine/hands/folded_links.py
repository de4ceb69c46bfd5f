"""Links at the end of a branch that fold back beside their finger, as bars of a linkage that the file leaves open."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.geometry.body import Body
from grasp_refine.hands.files.fingertips import PAD_NAMES, branch_ends
from grasp_refine.hands.files.mimics import curves, mimic_map
from grasp_refine.hands.files.tree import Joint, joints_above, rigid_parts
from grasp_refine.hands.files.tree_poses import tree_poses

MIN_SHARE = 0.1
"""Least share of its reach by which the end of a finger is farther out than a link that folds back; none where names of
links say that one is a pad."""


def folded_links(
    base_link: str, joints: Sequence[Joint], independent: Sequence[str], bodies: Mapping[str, Body]
) -> dict[str, str]:
    """Return end of a branch that folds back -> first link of the rigid part of its finger that is farthest out.

    Reach is the largest distance from the first joint of the finger, with joints at 0 and in the middle of their
    ranges: in both, an inner part reaches farther.

    Args:
        base_link: Link that the first joints hang from.
        joints: All joints, parents before children.
        independent: Names of the n independent joints.
        bodies: Link -> its collision geometry, of links with any.
    """
    ends = branch_ends(bodies, joints)
    ways = {end: [joint for joint in joints_above(end, joints)[::-1] if joint.movable] for end in ends}
    part = rigid_parts(joints)
    solids: dict[str, list[str]] = {}
    for name in bodies:
        solids.setdefault(part.get(name, name), []).append(name)
    T = _poses(base_link, joints, independent) if any(len(way) > 1 for way in ways.values()) else {}
    found = {}
    for end in ends:
        others = {joint.name for other in ends if part[other] != part[end] for joint in ways[other]}
        own = [joint for joint in ways[end] if joint.name not in others]
        parts = [joint.child for joint in own if joint.child in solids]
        if len(parts) < 2:
            continue
        origin = (T[own[0].parent] @ own[0].T_parent_child)[:, :3, 3]
        reach = {first: np.max([_reach(bodies[name], T[name], origin) for name in solids[first]], 0) for first in parts}
        best, last = max(parts, key=lambda first: float(reach[first][0])), part[end]
        pads = [any(re.search(PAD_NAMES, name.lower()) for name in solids[first]) for first in (best, last)]
        share = 0.0 if pads == [True, False] else MIN_SHARE
        if best != last and (reach[last] < (1.0 - share) * reach[best]).all():
            found[end] = best
    return found


def _poses(
    base_link: str, joints: Sequence[Joint], independent: Sequence[str]
) -> dict[str, Float[np.ndarray, "2 4 4"]]:
    """Poses of all links with joints at 0, or at their limit next to it, and in the middle of their ranges."""
    by_name = {joint.name: joint for joint in joints}
    lower, upper = (np.array([getattr(by_name[name], end) for name in independent]) for end in ("lower", "upper"))
    limited = np.isfinite(lower) & np.isfinite(upper)
    middle = (np.where(limited, lower, 0.0) + np.where(limited, upper, 0.0)) / 2
    q = np.stack([np.clip(0.0, lower, upper), middle])
    matrix, offset, movable = mimic_map(joints, independent)
    values = q @ matrix.T + offset + curves(joints, independent)(q)
    return tree_poses(base_link, joints, dict(zip(movable, values.T, strict=True)))


def _reach(body: Body, T: Float[np.ndarray, "K 4 4"], origin: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, " K"]:
    """Largest distance (K,) in metres of a body at poses T from points."""
    center = np.einsum("kij,kj->ki", T[:, :3, :3].mT, origin - T[:, :3, 3])  # in the frame of the link
    return np.max(
        [np.linalg.norm(piece.vertices - center[:, None], axis=2).max(axis=1) + piece.radius for piece in body.pieces],
        0,
    )
