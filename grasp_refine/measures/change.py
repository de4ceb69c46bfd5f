"""Change of grasps by refinement: the links that touch before and after, and how far their contacts moved."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.array_types import Bool, Float, Shaped
from grasp_refine.core.se3 import inverse, transform_points
from grasp_refine.measures.geometry import mean_over_links

MOVED_M = 0.005
"""Distance in metres up to which contacts, or a hand, did not move to speak of."""
SAME_GRASP = 0.5
"""Share of the links that touch before or after a refinement; where fewer touch in both, it is another grasp."""


class Change(StrEnum):
    """Change of a grasp by its refinement, from none to a new grasp."""

    KEPT = "kept"
    """The same links touch, and their contacts moved by at most `MOVED_M`."""
    MOVED = "contacts moved"
    """The same links touch, and their contacts moved farther."""
    LINKS = "other links"
    """Some links touch before or after alone."""
    GRASP = "other grasp"
    """Less than `SAME_GRASP` of the links that touch before or after touch in both, or none does."""


def contacts_moved(
    kept: Bool[np.ndarray, "N L"],
    before: Witness,
    T_before: Float[np.ndarray, "N L 4 4"],
    T_after: Float[np.ndarray, "N L 4 4"],
) -> Float[np.ndarray, " N"]:
    """Return the mean distance (N,) by which contact points moved on the object, metres; NaN without kept links.

    The contact point of a link is its witness point before refinement, which then moves with the link: the witness
    point itself jumps on flat faces.

    Args:
        kept: Links (N, L) that touch before and after.
        before: Witness points (N, L) before refinement, world frame.
        T_before: Poses of the links (N, L, 4, 4) before refinement.
        T_after: Poses of the links after it; the object is at rest.
    """
    moved = transform_points(T_after @ inverse(T_before), before.point_a) - before.point_a
    return mean_over_links(np.where(kept, np.linalg.norm(moved, axis=-1), np.nan))


def links_kept(before: Bool[np.ndarray, "N L"], after: Bool[np.ndarray, "N L"]) -> Float[np.ndarray, " N"]:
    """Return the share (N,) of the links (N, L) that touch before that touch after; NaN where none touches before."""
    count = before.sum(axis=1)
    return np.where(count > 0, (before & after).sum(axis=1) / np.maximum(count, 1), np.nan)


def changes(
    before: Bool[np.ndarray, "N L"], after: Bool[np.ndarray, "N L"], moved_m: Float[np.ndarray, " N"]
) -> Shaped[np.ndarray, " N"]:
    """Return the `Change` (N,) of grasps, as text.

    Args:
        before: Contact links (N, L) of the input grasps.
        after: Links (N, L) that touch after refinement.
        moved_m: Distances (N,) of `contacts_moved`.
    """
    both, either = (before & after).sum(axis=1), (before | after).sum(axis=1)
    conditions = [(both == 0) | (both < SAME_GRASP * either), both < either, ~(moved_m <= MOVED_M)]
    return np.select(conditions, [Change.GRASP.value, Change.LINKS.value, Change.MOVED.value], Change.KEPT.value)
