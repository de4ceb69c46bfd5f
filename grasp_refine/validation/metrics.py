"""Measures of grasps by geometry and statics alone, at the given poses, without any motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from grasp_refine.collision.query import Witness
from grasp_refine.core.array_records import join, take
from grasp_refine.core.plurals import count_text
from grasp_refine.core.short_repr import spread
from grasp_refine.forces.quality import quality
from grasp_refine.forces.squeeze import grasp_forces
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.self_collision import self_penetration, touching_pairs
from grasp_refine.objects.object import Object
from grasp_refine.scene.scene import Scene, links_of
from grasp_refine.validation.geometry import measure

MAX_FINGER_DISTANCE_M = 0.01
"""Largest distance in metres of a finger from the object that counts; farther ones count as this."""
CONTACT_DISTANCE_M = 0.002
"""Signed distance in metres within which a link counts as touching."""


@dataclass(frozen=True, eq=False)
class Metrics:
    """Measures of N grasps; NaN where a grasp is not finite, or a query failed."""

    contact_distance_m: Float[np.ndarray, " N"]
    """Mean distance (N,) of the fingers, of each its nearest contact link, metres, `MAX_FINGER_DISTANCE_M` at most."""
    contact_number: Float[np.ndarray, " N"]
    """Number of links within `CONTACT_DISTANCE_M` of the object (N,)."""
    penetration_m: Float[np.ndarray, " N"]
    """Deepest penetration of any link in the object (N,), metres."""
    self_penetration_m: Float[np.ndarray, " N"]
    """Deepest penetration of links in each other (N,), metres."""
    limits_violated: Float[np.ndarray, " N"]
    """Number of joint values beyond their limits (N,)."""
    wrench_residual: Float[np.ndarray, " N"]
    """Wrench that the best contact forces leave unbalanced (N,), as in `ContactForces.residual`; NaN without contacts
    too."""
    quality: Float[np.ndarray, " N"]
    """`Quality.value` (N,), from 0 to 1; NaN without contacts too."""

    def __repr__(self) -> str:
        quality, depth = spread(self.quality), spread(self.penetration_m)
        return f"Metrics({count_text(len(self), 'grasp')}: quality {quality}, penetration {depth} m, ...)"

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.penetration_m)

    def select(self, rows: np.ndarray) -> Metrics:
        """Return the grasps `rows`, in that order."""
        return take(self, rows)

    @staticmethod
    def join(parts: Sequence[Metrics]) -> Metrics:
        """Return the grasps of all parts, in that order."""
        return join(*parts)


def metrics(hand: Hand, obj: Object, T_world_root: np.ndarray, q: np.ndarray) -> Metrics:
    """Measure penetration, gaps, contacts, limits, wrench residual and quality of grasps on one object at the origin.

    Args:
        hand: The hand.
        obj: The object.
        T_world_root: Poses (N, 4, 4) of the base link in the object's frame; otherwise as in `Scene`.
        q: Joint values (N, n).

    Returns:
        Measures, NaN for invalid poses (`Scene.posed`).

    Raises:
        GraspRefineError: an argument of another type or shape.
    """
    scene = Scene(hand, obj, T_world_root, q)
    scene = scene.masked(scene.posed)
    T_world_root, q = scene.T_world_root, scene.q
    links = tuple(dict.fromkeys(links_of(hand)))  # a link with several contact points appears several times
    no_target = np.full((len(q), len(links), 3), np.nan)
    found = measure(hand, obj, links, T_world_root, q, no_target, no_target)
    known = found.witness.valid.all(axis=1)
    forces = grasp_forces(hand, obj, links, found.witness)

    def where_known(values: np.ndarray) -> np.ndarray:
        return np.where(known, values, np.nan)

    return Metrics(
        contact_distance_m=where_known(_contact_distance(hand, links, found.distance)),
        contact_number=where_known((found.distance <= CONTACT_DISTANCE_M).sum(axis=1)),
        penetration_m=where_known(found.penetration),
        self_penetration_m=where_known(self_penetration(hand, touching_pairs(hand), q)),
        limits_violated=where_known(found.limits_violated),
        wrench_residual=where_known(forces.residual),
        quality=quality_values(hand, obj, links, T_world_root, q, found.witness),
    )


def quality_values(
    hand: Hand, obj: Object, links: tuple[str, ...], T_world_root: np.ndarray, q: np.ndarray, witness: Witness
) -> Float[np.ndarray, " N"]:
    """Return `Quality.value` of grasps (N,); NaN where one is not finite, or a query failed.

    Args:
        hand: The hand.
        obj: The object.
        links: Its links with collision geometry.
        T_world_root: Poses (N, 4, 4) of the base link in the object's frame.
        q: Joint values (N, n).
        witness: Witness points (N, L) of the links and the object.
    """
    known = witness.valid.all(axis=1)
    T, q = np.where(known[:, None, None], T_world_root, np.eye(4)), np.where(known[:, None], q, 0.0)
    chain = Chain(hand, links)
    return np.where(known, quality(hand, obj, chain, chain(T, q), witness).value, np.nan)


def _contact_distance(
    hand: Hand, links: tuple[str, ...], distance: Float[np.ndarray, "N L"]
) -> Float[np.ndarray, " N"]:
    """Return the mean distance (N,) of the fingers in metres, NaN for a hand without fingers."""
    fingers: dict[str, set[int]] = {}
    for contact in hand.contacts:
        fingers.setdefault(contact.group, set()).add(links.index(contact.link))
    if not fingers:
        return np.full(len(distance), np.nan)
    nearest = np.stack([distance[:, sorted(columns)].min(axis=1) for columns in fingers.values()])
    return np.clip(nearest, 0.0, MAX_FINGER_DISTANCE_M).mean(axis=0)
