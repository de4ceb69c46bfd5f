"""Joint torques that make contact forces, and how much of what the actuators can make they are."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from grasp_refine.hands.chain import Chain, Frames
from grasp_refine.hands.hand import Hand

MIN_LIMIT = 1e-6
"""Smallest limit, in N m or N, by which torques are divided."""


def joint_torques(
    chain: Chain,
    frames: Frames,
    force: Float[np.ndarray, "N P K 3"],
    point: Float[np.ndarray, "N K 3"],
    link: Int[np.ndarray, "N K"],
) -> Float[np.ndarray, "N P n"]:
    """Return the torques J^T f (N, P, n) of the joints, in N m or N per unit of force, that make forces at rest.

    Args:
        chain: Kinematics of the L links.
        frames: Poses of the links.
        force: P forces on the object at each of K contact points, world frame.
        point: Points of the links that push, world frame; any finite one without a force.
        link: Index of the link of each point.
    """
    N, P, K = force.shape[:3]
    # A force at the contact does work on the twist of the link: f . V(x) = f . v + (x x f) . w.
    covector = np.concatenate([force, np.cross(point[:, None], force)], axis=-1).reshape(N, P * K, 6)
    torque = chain.to_joint_space(frames, covector, np.tile(link, (1, P)))[..., 6:]
    return torque.reshape(N, P, K, torque.shape[-1]).sum(axis=2)


def limit_shares(hand: Hand, torque: Float[np.ndarray, "*N n"]) -> Float[np.ndarray, "*N n"]:
    """Return torques as shares (..., n) of what the actuators can make: 0 without a limit.

    Of joints that share an actuator, the share of the tension that comes nearest to their torques (see
    `squeeze.set_point_offsets`) is that of the first one, and the others have none.
    """
    limit = hand.actuator.force_limit
    demand = np.abs(torque)
    for group in hand.coupled:
        joints = [hand.joint_names.index(name) for name in group.joints]
        ratio = np.array(group.ratio)
        demand[..., joints] = 0.0
        demand[..., joints[0]] = np.abs(torque[..., joints] @ (ratio / (ratio @ ratio)))
    # A limit of 0 allows no torque at all.
    return demand / np.maximum(limit, MIN_LIMIT)
