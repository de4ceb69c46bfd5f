"""Geometric measures of grasps by a plain query, without smoothing or data of the refinement."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.collision.query import Witness, query
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import distances, transform_points
from grasp_refine.scene.hand_object import HandObject

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

    def columns(self, chosen: Sequence[int]) -> "Geometry":
        """Return the measures of some of the links."""
        at = list(chosen)
        return replace(
            self,
            distance=self.distance[:, at],
            contact_error=self.contact_error[:, at],
            witness=self.witness.pairs(at),
            T_world_link=self.T_world_link[:, at],
        )


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
    prepared: HandObject,
    T_world_root: np.ndarray,
    q: np.ndarray,
    target_link: np.ndarray,
    target_object: np.ndarray,
    margin: np.ndarray | float = 0.0,
    touching: np.ndarray | None = None,
) -> Geometry:
    """Measure grasps (N poses (N, 4, 4) and joint values (N, n)) on one object at the world's origin.

    Args:
        prepared: Hand and object, whose links with collision geometry are measured.
        T_world_root: Poses of the base link in the object's frame.
        q: Joint values.
        target_link: Target points on the links (N, L, 3), link frames, metres; NaN: none.
        target_object: Target points on the object (N, L, 3), object frame, metres.
        margin: Gap in metres that contact links should keep, one for all or (N, L).
        touching: Links (N, L) that should touch; None: links with a target.
    """
    hand = prepared.hand
    with np.errstate(invalid="ignore"):  # grasps that are not finite have no result
        T_link = prepared.chain(T_world_root, q).T_world_link
    witness = query(prepared.pairs, T_link, np.broadcast_to(np.eye(4), T_link.shape))
    valid = witness.valid
    distance = np.where(valid, witness.distance, np.nan)
    if touching is None:
        touching = ~(np.isnan(target_link) | np.isnan(target_object)).any(axis=-1)
    gap = np.where(touching, margin, np.nan)
    deepest = np.where(valid, witness.distance, np.inf).min(axis=1)
    return Geometry(
        distance=distance,
        contact_error=contact_errors(distance, witness, T_link, gap, target_link, target_object),
        penetration=np.where(valid.any(axis=1), np.maximum(-deepest, 0.0), np.nan),
        limits_violated=((q > hand.upper + LIMIT_TOLERANCE) | (q < hand.lower - LIMIT_TOLERANCE)).sum(axis=1),
        witness=witness,
        T_world_link=T_link,
    )


def contact_errors(
    distance: np.ndarray,
    witness: Witness,
    T_world_link: np.ndarray,
    gap: np.ndarray,
    target_link: np.ndarray,
    target_object: np.ndarray,
) -> np.ndarray:
    """Return the largest of |distance - gap| and target misses of each contact link (N, L); NaN for other links.

    Args:
        distance: Signed distances (N, L) in metres of links and object.
        witness: Their witness points.
        T_world_link: Poses of the links (N, L, 4, 4).
        gap: Gap in metres that each contact link (N, L) should keep, as `contact_gaps`; NaN for other links.
        target_link: Target points on the links (N, L, 3), link frames, metres; NaN: none.
        target_object: Target points on the object (N, L, 3), object frame, metres.
    """
    miss_link = np.linalg.norm(witness.point_a - transform_points(T_world_link, target_link), axis=-1)
    miss_object = np.linalg.norm(witness.point_b - target_object, axis=-1)
    off = np.abs(distance - gap)
    return np.where(np.isnan(off), np.nan, np.fmax(off, np.maximum(miss_link, miss_object)))


def worst_over_links(values: np.ndarray) -> np.ndarray:
    """Return the largest of the values (..., L) of a measure per link; NaN where no link has one."""
    return np.fmax.reduce(values, axis=-1)


def mean_over_links(values: np.ndarray) -> np.ndarray:
    """Return the mean of the values (..., L) of a measure per link; NaN where no link has one."""
    known = ~np.isnan(values)
    count = known.sum(axis=-1)
    return np.where(count > 0, np.where(known, values, 0.0).sum(axis=-1) / np.maximum(count, 1), np.nan)


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
