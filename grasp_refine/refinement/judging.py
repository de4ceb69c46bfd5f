"""Judgement of grasps without simulation: a score that compares attempts, and the quality."""

from __future__ import annotations

import numpy as np

from grasp_refine.collision.query import Witness, query
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.se3 import transform_points
from grasp_refine.forces.equilibrium import mode_residual
from grasp_refine.forces.quality import quality
from grasp_refine.forces.squeeze import CONTACTS, contacts, pressure_shortfall
from grasp_refine.forces.strong_pushes import strong_push_residual
from grasp_refine.hands.chain import Frames
from grasp_refine.hands.palm import palm_poses
from grasp_refine.measures.fidelity import OTHER_M, OTHER_RAD, SAME_M, Fidelity
from grasp_refine.refinement.pinches import pinch_score
from grasp_refine.scene.contact_selection import link_groups
from grasp_refine.scene.demand import Demand
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene

SHORTFALL_WEIGHT = 0.2
"""Score of a grasp whose set points allow no pressure at all."""

YIELDING_WEIGHT = 0.5
"""Score of a grasp all of whose pressure turns a finger of a linkage, at the lever of `infeasible_torques`."""

MISS_SCALE_M = 0.0025
"""Distance in metres of a contact from where it should be that costs a score of 1."""


def judge(
    prepared: HandObject, frames: Frames, clearance: Float[np.ndarray, " L"] | float = 0.0, demand: Demand | None = None
) -> tuple[Float[np.ndarray, " N"], Bool[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Return the score (N,) of grasps, lower is better, where they have at most two contact points, and their quality.

    Of grasps whose links meet nothing but the object, the residual under the worst of the strong pushes, which counts
    as much as the shortcomings of `Quality` together, predicts which of several attempts holds a heavy object, or one
    in a simulation whose contacts creep. Grasps near the ends of set points, where a hand cannot press, cost as much as
    `SHORTFALL_WEIGHT`, grasps whose pressure turns fingers of linkages their `mode_residual` times `YIELDING_WEIGHT`,
    and grasps with two fingers their `pinch_score`. The score is infinite where there are no forces. Force and friction
    are of the task; without a `demand`, of `dexgraspbench`.
    """
    hand, obj, chain, faces, T = prepared.hand, prepared.object, prepared.chain, prepared.faces, frames.T_world_link
    cutoff = CONTACTS.cutoff(hand, chain.links)
    witness = query(prepared.pairs, T, np.broadcast_to(np.eye(4), T.shape), cutoff=cutoff)
    points = contacts(hand, obj, chain.links, witness, T, faces)
    demand = demand or Demand()
    pushed = strong_push_residual(points, obj, frames.T_world_root[:, :3, :3], demand.grip)
    found = quality(hand, obj, chain, frames, witness, clearance, faces, demand=demand)
    score = found.score + np.nan_to_num(pushed, nan=np.inf)
    score += SHORTFALL_WEIGHT * pressure_shortfall(hand, obj, chain, frames, points, demand)
    if hand.modes:
        score += YIELDING_WEIGHT * mode_residual(hand, obj, chain, frames, points, demand.grip)
    if hand.has_two_fingers:
        score += pinch_score(prepared, frames, witness, points)
    return score, np.isfinite(points.point[..., 0]).sum(axis=1) <= 2, np.nan_to_num(found.value)


def target_miss(scene: Scene, T_link: Float[np.ndarray, "N L 4 4"]) -> Float[np.ndarray, " N"]:
    """Return the largest distance (N,) in metres of a target on a link from the target on the object; 0 without any."""
    assert scene.target_link is not None and scene.target_object is not None
    miss = np.linalg.norm(transform_points(T_link, scene.target_link) - scene.target_object, axis=-1)
    return np.nan_to_num(miss).max(axis=1)


def original_miss(scene: Scene, witness: Witness, frames: Frames) -> Float[np.ndarray, " N"]:
    """Return how much farther than `SAME_M` a finger with a target is from its original's contact, metres.

    Of a transferred grasp it matters where a finger touches the object, not with which of its points. It is the largest
    (N,) over these fingers, 0 without any, and NaN where one does not touch; `OTHER_M` for another approach.
    """
    hand, links = scene.hand, scene.links
    assert scene.original is not None and scene.target_link is not None
    groups, aimed = np.array(link_groups(hand, links)), ~np.isnan(scene.target_link[..., 0])
    T_palm = palm_poses(hand, frames.T_world_root, frames.q)
    found = Fidelity.of(hand, links, scene.original, witness, T_palm)
    over = [
        np.where(aimed[:, groups == finger].any(axis=1), np.maximum(found.distance[:, k] - SAME_M, 0.0), 0.0)
        for k, finger in enumerate(hand.fingers)
    ]
    return np.where(found.turn > OTHER_RAD, OTHER_M, np.max(over, axis=0))
