"""Joint torques of contact forces, and their shares of the actuators' limits."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.hands.chain import Chain, Frames
from grasp_refine.hands.hand import Hand

MIN_LIMIT = 1e-6
"""Smallest bound, in N m or N, by which torques are divided."""

GIVE_RAD = 0.1
"""Angle by which a joint may give way to the object where its set points end, and still hold it."""


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


def tensions(hand: Hand, torque: Float[np.ndarray, "*N n"]) -> Float[np.ndarray, "*N n"]:
    """Return the actuator torques of joint torques (..., n): of a coupled group the tension, at its first joint.

    It is the tension that comes nearest to their torques (see `squeeze.set_point_offsets`); other joints of it have 0.
    """
    demand = torque.copy()
    for group in hand.coupled:
        joints = [hand.joint_names.index(name) for name in group.joints]
        ratio = np.array(group.ratio)
        demand[..., joints] = 0.0
        demand[..., joints[0]] = torque[..., joints] @ (ratio / (ratio @ ratio))
    return demand


def torque_bounds(
    hand: Hand, q: Float[np.ndarray, "*N n"], give: float = 0.0
) -> tuple[Float[np.ndarray, "*N n"], Float[np.ndarray, "*N n"]]:
    """Return the least and the greatest torque (..., n) that each actuator can make, in N m or N.

    A position actuator makes `Hand.stiffness` times the distance to its set point, which ends where
    `Actuator.set_points` do, and at most its force limit. Bounds of a coupled group apply to its tension, the same
    for all its joints.

    Args:
        hand: The hand.
        q: Joint values (..., n) at which the joints rest.
        give: Angle in rad by which a joint may give way before it makes them; a slide by as much as counts like it.
    """
    limit, ends = hand.actuator.force_limit, hand.actuator.set_points
    least, greatest = np.broadcast_to(-limit, q.shape), np.broadcast_to(limit, q.shape)
    if ends is None:
        return least, greatest
    length = q.copy()
    for group in hand.coupled:
        joints = [hand.joint_names.index(name) for name in group.joints]
        length[..., joints] = (q[..., joints] @ np.array(group.ratio))[..., None]
    way, kp = give * hand.per_radian, hand.stiffness
    # Without stiffness there is no torque, however far a set point may be.
    below = kp * np.where(kp > 0.0, np.minimum(ends[:, 0] - length - way, 0.0), 0.0)
    above = kp * np.where(kp > 0.0, np.maximum(ends[:, 1] - length + way, 0.0), 0.0)
    return np.maximum(least, below), np.minimum(greatest, above)


def limit_shares(
    hand: Hand, torque: Float[np.ndarray, "*N n"], q: Float[np.ndarray, "*#N n"]
) -> Float[np.ndarray, "*N n"]:
    """Return torques as shares (..., n) of the actuators' limits: 0 without a limit.

    Of joints that share an actuator the first has the share of their tension, and the others have none.

    Args:
        hand: The hand.
        torque: Torques of the joints, in N m or N.
        q: Joint values at which they are made.
    """
    least, greatest = torque_bounds(hand, q, GIVE_RAD)
    demand = tensions(hand, torque)
    # A limit of 0 allows no torque at all.
    return np.abs(demand) / np.maximum(np.where(demand < 0.0, -least, greatest), MIN_LIMIT)
