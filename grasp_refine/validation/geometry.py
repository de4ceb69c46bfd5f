"""Geometric measures of grasps by a plain query, without smoothing or data of the refinement."""

from dataclasses import dataclass

import numpy as np

from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import distances, transform_points
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object

LIMIT_TOLERANCE = 1e-6
"""Distance (rad or m) beyond a joint limit that does not count as a violation."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """Measures of N grasps over L links; columns are the given links."""

    distance: np.ndarray
    """Signed distance (N, L) in metres of each link to the object; NaN where the query failed."""
    contact_error: np.ndarray
    """Largest of gap |d - beta| and target misses (N, L) in metres; NaN for links that should not touch."""
    penetration: np.ndarray
    """Deepest penetration (N,) over all links, in metres."""
    limits_violated: np.ndarray
    """Number of joints beyond their limits (N,)."""
    witness: Witness
    """Witness points (N, L), world frame."""
    T_world_link: np.ndarray
    """Poses of the links (N, L, 4, 4)."""


@dataclass(frozen=True, eq=False)
class Movement:
    """Movements of N grasps."""

    palm_m: np.ndarray
    """Distance of the base link's origin (N,), metres."""
    palm_rad: np.ndarray
    """Rotation of the base link (N,), radians."""
    joints_rad: np.ndarray
    """Largest movement of a joint that turns (N,), radians; NaN where the hand has none."""
    slides_m: np.ndarray
    """Largest movement of a joint that slides (N,), metres; NaN where the hand has none."""


@stage("measuring")
def measure(
    hand: Hand,
    obj: Object,
    links: tuple[str, ...],
    T_world_root: np.ndarray,
    q: np.ndarray,
    target_link: np.ndarray,
    target_object: np.ndarray,
    margin: np.ndarray | float = 0.0,
    touching: np.ndarray | None = None,
) -> Geometry:
    """Measure grasps (N poses (N, 4, 4) and joint values (N, n)) on one object at the world's origin.

    Args:
        hand: The hand.
        obj: The object.
        links: Links with collision geometry to measure.
        T_world_root: Poses of the base link in the object's frame.
        q: Joint values.
        target_link: Target points on the links (N, L, 3), link frames, metres; NaN: none.
        target_object: Target points on the object (N, L, 3), object frame, metres.
        margin: Gap in metres that contact links should keep, one for all or (N, L).
        touching: Links (N, L) that should touch; None: those with a target.
    """
    bodies = hand.links_by_name
    pairs = Pairs.against([bodies[name].solid for name in links], obj.body)
    with np.errstate(invalid="ignore"):  # grasps that are not finite have no result
        T_link = Chain(hand, links)(T_world_root, q).T_world_link
    witness = query(pairs, T_link, np.broadcast_to(np.eye(4), T_link.shape))
    valid = witness.valid
    distance = np.where(valid, witness.distance, np.nan)
    miss_link = np.linalg.norm(witness.point_a - transform_points(T_link, target_link), axis=-1)
    miss_object = np.linalg.norm(witness.point_b - target_object, axis=-1)
    gap, miss = np.abs(distance - margin), np.maximum(miss_link, miss_object)
    if touching is None:
        error = np.maximum(gap, miss)
    else:
        error = np.where(touching, np.fmax(gap, np.where(np.isnan(gap), np.nan, miss)), np.nan)
    deepest = np.where(valid, witness.distance, np.inf).min(axis=1)
    return Geometry(
        distance=distance,
        contact_error=error,
        penetration=np.where(valid.any(axis=1), np.maximum(-deepest, 0.0), np.nan),
        limits_violated=((q > hand.upper + LIMIT_TOLERANCE) | (q < hand.lower - LIMIT_TOLERANCE)).sum(axis=1),
        witness=witness,
        T_world_link=T_link,
    )


def movement(
    T_before: np.ndarray, q_before: np.ndarray, T_after: np.ndarray, q_after: np.ndarray, slides: np.ndarray
) -> Movement:
    """Return the movements of palm poses (N, 4, 4) and joint values (N, n); NaN where they are not finite.

    `slides` (n,) is `Hand.slides`.
    """
    moved, turned = distances(T_before, T_after)
    away = np.abs(q_after - q_before)
    joints, sliding = (
        away[:, kind].max(axis=1) if kind.any() else np.full(len(away), np.nan) for kind in (~slides, slides)
    )
    return Movement(moved, turned, joints, sliding)
