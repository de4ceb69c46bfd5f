"""Measures of grasps by one plain query, independent of the method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from grasp_refine.collision.query import query
from grasp_refine.forces.quality import quality
from grasp_refine.forces.squeeze import CONTACTS, grasp_forces
from grasp_refine.hands.self_collision import self_penetration, touching_pairs
from grasp_refine.scene.hand_object import HandObject


@dataclass(frozen=True, eq=False)
class Measures:
    """Measures of N grasps; NaN where a query failed."""

    penetration_m: Float[np.ndarray, " N"]
    """Deepest penetration of any link in the object (N,), metres."""
    self_penetration_m: Float[np.ndarray, " N"]
    """Deepest penetration of links in each other (N,), metres."""
    contact_gap_m: Float[np.ndarray, " N"]
    """Largest distance to the object's surface, inside or outside, of the links that touch (N,), metres; NaN without
    any."""
    wrench_residual: Float[np.ndarray, " N"]
    """Residual force and torque when the contacts balance them best (N,); NaN without contacts."""
    quality: Float[np.ndarray, " N"]
    """Quality (N,), `quality.Quality.value`; 0 where there are no forces."""


def measure_grasps(
    prepared: HandObject,
    T_world_root: Float[np.ndarray, "N 4 4"],
    q: Float[np.ndarray, "N n"],
    touching: Bool[np.ndarray, "N L"] | None = None,
) -> Measures:
    """Measure grasps on an object at the world's origin.

    Args:
        prepared: Hand and object.
        T_world_root: Poses of the base link.
        q: Joint values.
        touching: Links that touch; None: those that are near, as for forces.
    """
    hand, obj, chain = prepared.hand, prepared.object, prepared.chain
    frames = chain(T_world_root, q)
    T_link = frames.T_world_link
    witness = query(prepared.pairs, T_link, np.broadcast_to(np.eye(4), T_link.shape))
    known = witness.valid.all(axis=1)
    touching = CONTACTS.choose(hand, chain.links, witness) if touching is None else touching
    gap = np.where(touching & witness.valid, np.abs(witness.distance), -np.inf).max(axis=1)
    depth = np.where(witness.valid, -witness.distance, 0.0).max(axis=1, initial=0.0)
    forces = grasp_forces(hand, obj, chain.links, witness)

    def where_known(values: np.ndarray) -> np.ndarray:
        return np.where(known, values, np.nan)

    return Measures(
        penetration_m=where_known(depth),
        self_penetration_m=where_known(self_penetration(hand, touching_pairs(hand), q)),
        contact_gap_m=where_known(np.where(np.isfinite(gap), gap, np.nan)),
        wrench_residual=where_known(forces.residual),
        quality=np.nan_to_num(quality(hand, obj, chain, frames, witness).value),
    )
