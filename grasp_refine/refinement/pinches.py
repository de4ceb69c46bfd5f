"""Score of grasps with two fingers beyond their forces: what lies under the fingers, and how far they can move.

Forces hardly predict which of such grasps hold, since two contacts never balance a torque about the line between them.
Grasps are lost whose fingers sit on an edge, off which the object rotates, or can neither open for it nor follow it.
"""

from __future__ import annotations

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.forces.contact_points import ContactPoints
from grasp_refine.forces.torques import joint_torques
from grasp_refine.geometry.sampling import Candidates
from grasp_refine.hands.chain import Frames
from grasp_refine.scene.hand_object import HandObject

BEST_SCORE = 0.43
"""Score of the best grasps with two fingers, without what is here: of antipodal contacts whose line goes through the
centre of mass."""

EDGE_WEIGHT, ROOM_WEIGHT = 1.0, 0.3
"""Score of a finger on nothing but edges, and of one that cannot move."""

NEIGHBOURS = 8
"""Number of surface points around a contact: within a centimetre for an object as large as a cup."""

OPPOSITE = -0.3
"""Cosine to the normal of a contact below which a surface point is on the other side of a wall."""

ROOM_M = 0.002
"""Distance in metres by which fingers should be able to open, and to follow an object that gives way."""


def pinch_score(
    prepared: HandObject, frames: Frames, witness: Witness, points: ContactPoints
) -> Float[np.ndarray, " N"]:
    """Return the penalty (N,) on the score of grasps with two fingers, for the worse finger; 0 at best.

    Args:
        prepared: Geometry of the hand and the object.
        frames: Poses of the L links.
        witness: Witness points (N, L) of links and object.
        points: Contact points.
    """
    own = (points.link[..., None] == np.arange(len(prepared.chain.links))) & np.isfinite(points.point[..., :1])
    touching = own.any(axis=1)
    share = np.where(touching[:, None], own / np.maximum(own.sum(axis=1, keepdims=True), 1), 0.0)
    # The middle of a patch stands for its corners.
    middle, normal = (np.einsum("nkl,nkx->nlx", share, np.nan_to_num(part)) for part in (points.point, points.normal))
    edges = np.where(touching, edge_shares(prepared.object.body.candidates, middle, normal), 0.0)
    room = finger_room(prepared, frames, witness, touching)
    return EDGE_WEIGHT * edges.max(axis=1) + ROOM_WEIGHT * (1.0 - np.minimum(room / ROOM_M, 1.0))


def edge_shares(
    surface: Candidates, point: Float[np.ndarray, "N L 3"], normal: Float[np.ndarray, "N L 3"]
) -> Float[np.ndarray, "N L"]:
    """Return the share (N, L) of the surface around points that turns away from their normals, from 0 to 1.

    It is 0 on a flat face and one half on the edge of a box. The other side of a thin wall does not count.

    Args:
        surface: Surface points of the object.
        point: Points on it.
        normal: Unit normals into the object.
    """
    apart = np.linalg.norm(surface.points - point[..., None, :], axis=-1)
    near = np.argsort(apart, axis=-1)[..., :NEIGHBOURS]
    cosine = -(surface.normals[near] * normal[..., None, :]).sum(axis=-1)
    counts = cosine > OPPOSITE
    facing = np.where(counts, np.maximum(cosine, 0.0), 0.0).sum(axis=-1)
    return 1.0 - facing / np.maximum(counts.sum(axis=-1), 1)


def finger_room(
    prepared: HandObject, frames: Frames, witness: Witness, touching: Bool[np.ndarray, "N L"]
) -> Float[np.ndarray, " N"]:
    """Return the distance (N,) in metres by which the finger with the least room can move along its contact normal.

    That is, to first order, what the limits of its joints leave towards the object or away from it, whichever is less;
    infinite where no finger touches. Joints of an arm do not count.

    Args:
        prepared: Geometry of the hand and the object.
        frames: Poses of the L links.
        witness: Witness points (N, L) of links and object.
        touching: Links that touch.
    """
    hand, q = prepared.hand, frames.q
    N, L = touching.shape
    normal = np.where(touching[..., None], witness.normal, 0.0)
    pushes = np.eye(L)[None, :, :, None] * normal[:, None]
    link = np.broadcast_to(np.arange(L), (N, L))
    slope = joint_torques(prepared.chain, frames, pushes, np.nan_to_num(witness.point_b), link)
    slope = np.where(hand.arm_joints, 0.0, slope)
    above, below = (np.clip(way, 0.0, hand.per_radian)[:, None] for way in (hand.upper - q, q - hand.lower))
    closing = (np.abs(slope) * np.where(slope > 0.0, above, below)).sum(axis=-1)
    opening = (np.abs(slope) * np.where(slope > 0.0, below, above)).sum(axis=-1)
    moves = touching & slope.any(axis=-1)
    return np.where(moves, np.minimum(closing, opening), np.inf).min(axis=1)
