"""Stiffness of grasps: how far the object gives way to a load while its contacts stick, and whether it stays at all.

Position actuators are springs, and so are contacts: the object rests on them in series and in parallel (Cutkosky and
Kao, "Computing and controlling the compliance of a robotic hand", IEEE Transactions on Robotics and Automation 5(2),
1989). Contacts are soft fingers, which resist turning about their normal, too. The forces with which the hand presses
turn with what they act on, which makes the grasp softer: fingers that press an object between them turn it away, as a
rod buckles, where springs do not hold it (Howard and Kumar, "On the stability of grasped objects", IEEE Transactions on
Robotics and Automation 12(6), 1996; curvatures of the surfaces, about which contacts roll, are left out here).
"""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_records import take
from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.se3 import cross, hat
from grasp_refine.forces.contact_points import ContactPoints
from grasp_refine.hands.chain import Chain, Frames
from grasp_refine.hands.hand import Hand

CONTACT_STIFFNESS = 5e4
"""Stiffness in N/m, in any direction, of a contact with the mean pressure of its grasp, as in simulations: a
fingertip that presses with 5 N sinks in by 0.1 mm. That of others is in proportion to their pressures."""

TORSION_LEVER_M = 0.01
"""Lever in metres of that stiffness about the normal."""

MIN_STIFFNESS = 1e-6
"""Stiffness, in N m/rad or N/m, of joints without actuators, and of directions without contact."""


def object_motion(
    hand: Hand,
    chain: Chain,
    frames: Frames,
    points: ContactPoints,
    force: Float[np.ndarray, "N K 3"],
    center: Float[np.ndarray, " 3"],
    loads: Float[np.ndarray, "N P 6"],
) -> Float[np.ndarray, "N P 6"]:
    """Return how the object moves under small loads: translation of its centre in metres, and rotation in rad.

    The potential energy is that of all springs, less the work of the contact forces on object and links. Its second
    derivatives, by the motion of the object and by the joint values, are the stiffness of the grasp: the grasp is
    stable where they are positive definite. The root of the hand, and an arm, rest.

    Args:
        hand: The hand, whose actuators are springs.
        chain: Kinematics of its links.
        frames: Poses of the links.
        points: Contact points.
        force: Forces in N of the hand on the object at these points; contacts without a force do not hold.
        center: The object's centre of mass.
        loads: Forces in N and torques about `center` in N m, in the frame of the contacts.

    Returns:
        Motions, infinite where the grasp is unstable.
    """
    motion = np.zeros(loads.shape)
    for rows, some in points.groups():
        f, here = force[rows, : some.point.shape[1]], take(frames, rows)
        pressure = np.nan_to_num((f * some.normal).sum(axis=-1))
        held = (pressure > 0.0)[..., None]
        mean = pressure.sum(axis=1, keepdims=True, where=held[..., 0]) / np.maximum(held.sum(axis=1), 1)
        along = CONTACT_STIFFNESS * np.divide(pressure, mean, out=np.zeros_like(pressure), where=held[..., 0])
        D = np.concatenate([np.repeat(along, 3, axis=1), TORSION_LEVER_M**2 * along], axis=1)[..., None]
        f, normal, arm, point = (
            np.where(held, part, 0.0) for part in (f, some.normal, some.point - center, some.point_on_link)
        )
        A = _contact_forms(arm, normal)
        link = np.concatenate([np.repeat(some.link, 3, axis=1), some.link], axis=1)
        J = np.where(hand.arm_joints, 0.0, chain.to_joint_space(here, _contact_forms(point, normal), link)[..., 6:])
        both = np.concatenate([A, -J], axis=-1)
        K = (both * D).mT @ both
        K[:, 3:6, 3:6] += _turned_forces(f, arm)
        K[:, 6:, 6:] += joint_stiffness(hand) + _moved_torques(hand, chain, here, f, point, some.link)
        K += MIN_STIFFNESS * np.eye(K.shape[-1])
        loaded = np.concatenate([loads[rows], np.zeros((*loads[rows].shape[:2], J.shape[-1]))], axis=-1)
        moved = np.linalg.solve(K, loaded.mT).mT[..., :6]
        stable = np.linalg.eigvalsh(K)[:, :1, None] > 0.0
        motion[rows] = np.where(stable, moved, np.inf)
    return motion


def joint_stiffness(hand: Hand) -> Float[np.ndarray, "n n"]:
    """Return the stiffness (n, n) of the independent joints, in N m/rad or N/m: joints of a tendon give in turn."""
    kp = hand.stiffness
    K = np.diag(kp)
    for group in hand.coupled:
        joints = [hand.joint_names.index(name) for name in group.joints]
        K[np.ix_(joints, joints)] = kp[joints[0]] * np.outer(group.ratio, group.ratio)
    return K + MIN_STIFFNESS * np.eye(len(kp))


def _turned_forces(force: Float[np.ndarray, "N K 3"], arm: Float[np.ndarray, "N K 3"]) -> Float[np.ndarray, "N 3 3"]:
    """Return the stiffness (N, 3, 3) in N m/rad of forces on the object: negative where they press it together.

    Turned by w, the point at r moves by w x r + w x (w x r) / 2, and on the second a force f does the work
    f . (w (w . r) - r w . w) / 2.
    """
    outer = force.mT @ arm
    return outer.trace(axis1=1, axis2=2)[:, None, None] * np.eye(3) - 0.5 * (outer + outer.mT)


def _moved_torques(
    hand: Hand,
    chain: Chain,
    frames: Frames,
    force: Float[np.ndarray, "N K 3"],
    point: Float[np.ndarray, "N K 3"],
    link: Int[np.ndarray, "N K"],
) -> Float[np.ndarray, "N n n"]:
    """Return the derivatives (N, n, n) of the joint torques J^T f by the joint values, at forces that stay the same.

    A joint turns the joints beyond it, and the points of their links: for a joint i before j, or j itself, the
    derivative of f . V_j(p) is f . (w_i x V_j(p)). Of joints that follow others on a curve, the change of slope is left
    out.
    """
    v, w = (frames.axes[:, part, 6:].mT for part in (slice(3), slice(3, 6)))
    moves = chain.joint_mask(link)[..., 6:, None]
    velocity = v[:, None] + cross(w[:, None], point[:, :, None])
    turning = (moves * cross(velocity, force[:, :, None])).sum(axis=1)
    before = chain.joint_mask(len(chain.links) + np.arange(len(chain.joints)))[:, 6:]
    half = before * (turning @ w.mT) * (1.0 - 0.5 * np.eye(len(before)))
    change = chain.joint_gains.T @ (half + half.mT) @ chain.joint_gains
    return np.where(hand.arm_joints[:, None] | hand.arm_joints, 0.0, change)


def _contact_forms(
    point: Float[np.ndarray, "N K 3"], normal: Float[np.ndarray, "N K 3"]
) -> Float[np.ndarray, "N K4 6"]:
    """Return the velocities (N, 3 K) of points, then the angular ones (N, K) about normals, as forms of twists."""
    N, K = point.shape[:2]
    # Rows e of a point: e . (v + w x p) = e . v + (p x e) . w.
    linear = np.concatenate([np.broadcast_to(np.eye(3), (N, K, 3, 3)), -hat(point)], axis=-1)
    angular = np.concatenate([np.zeros_like(normal), normal], axis=-1)
    return np.concatenate([linear.reshape(N, 3 * K, 6), angular], axis=1)
