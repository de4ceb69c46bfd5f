"""Stiffness of grasps: how far the object gives way to a load while its contacts stick.

Position actuators are springs, and so are contacts: the object rests on them in series and in parallel (Cutkosky and
Kao, "Computing and controlling the compliance of a robotic hand", IEEE Transactions on Robotics and Automation 5(2),
1989). Contacts are soft fingers, which resist turning about their normal, too. Where they lie close together, the
object turns under a push past them, however well their forces balance it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from grasp_refine.core.array_records import take
from grasp_refine.core.se3 import hat
from grasp_refine.forces.contact_points import ContactPoints
from grasp_refine.hands.chain import Chain, Frames
from grasp_refine.hands.hand import Hand

CONTACT_STIFFNESS = 2e3
"""Stiffness in N/m, in any direction, of a contact with the mean pressure of those of its grasp; that of others is in
proportion to their pressures."""

TORSION_LEVER_M = 0.02
"""Lever in metres of that stiffness about the normal: the torsional friction of the protocol `dexgraspbench`."""

MIN_STIFFNESS = 1e-6
"""Stiffness, in N m/rad or N/m, of joints without actuators, and of what no contact holds."""


def object_motion(
    hand: Hand,
    chain: Chain,
    frames: Frames,
    points: ContactPoints,
    pressure: Float[np.ndarray, "N K"],
    center: Float[np.ndarray, " 3"],
    loads: Float[np.ndarray, "N P 6"],
) -> Float[np.ndarray, "N P 6"]:
    """Return how the object moves under small loads: translation of its centre in metres, and rotation in rad.

    The potential energy of all springs is least over the joint values, which gives the stiffness of the object
    K = A^T D A - (A^T D J) (K_q + J^T D J)^-1 (J^T D A): A and J take the motion of the object and of the joints to
    those of the contacts, whose stiffnesses are D. The root of the hand, and an arm, rest.

    Args:
        hand: The hand, whose actuators have the stiffnesses K_q.
        chain: Kinematics of its links.
        frames: Poses of the links.
        points: Contact points.
        pressure: Pressures at these, in any unit; those without any hold nothing.
        center: The object's centre of mass.
        loads: Forces in N and torques about `center` in N m, in the frame of the contacts.
    """
    motion = np.zeros(loads.shape)
    for rows, some in points.groups():
        share = pressure[rows, : some.point.shape[1]]
        there = share > 0.0
        mean = share.sum(axis=1, keepdims=True) / np.maximum(there.sum(axis=1, keepdims=True), 1)
        along = CONTACT_STIFFNESS * np.divide(share, mean, out=np.zeros_like(share), where=there)
        D = np.concatenate([np.repeat(along, 3, axis=1), TORSION_LEVER_M**2 * along], axis=1)[..., None]
        held = there[..., None]
        normal = np.where(held, some.normal, 0.0)
        A = _contact_forms(np.where(held, some.point - center, 0.0), normal)
        link = np.concatenate([np.repeat(some.link, 3, axis=1), some.link], axis=1)
        twist = _contact_forms(np.where(held, some.point_on_link, 0.0), normal)
        J = np.where(hand.arm_joints, 0.0, chain.to_joint_space(take(frames, rows), twist, link)[..., 6:])
        JD = (J * D).mT
        shared = JD @ A
        K = (A * D).mT @ A - shared.mT @ np.linalg.solve(joint_stiffness(hand) + JD @ J, shared)
        motion[rows] = np.linalg.solve(K + MIN_STIFFNESS * np.eye(6), loads[rows].mT).mT
    return motion


def joint_stiffness(hand: Hand) -> Float[np.ndarray, "n n"]:
    """Return the stiffness (n, n) of the independent joints, in N m/rad or N/m: joints of a tendon give in turn."""
    kp = np.maximum(hand.actuator.kp, 0.0)
    K = np.diag(kp)
    for group in hand.coupled:
        joints = [hand.joint_names.index(name) for name in group.joints]
        K[np.ix_(joints, joints)] = kp[joints[0]] * np.outer(group.ratio, group.ratio)
    return K + MIN_STIFFNESS * np.eye(len(kp))


def _contact_forms(
    point: Float[np.ndarray, "N K 3"], normal: Float[np.ndarray, "N K 3"]
) -> Float[np.ndarray, "N K4 6"]:
    """Return the velocities (N, 3 K) of points, then the angular ones (N, K) about normals, as forms of twists."""
    N, K = point.shape[:2]
    # Rows e of a point: e . (v + w x p) = e . v + (p x e) . w.
    linear = np.concatenate([np.broadcast_to(np.eye(3), (N, K, 3, 3)), -hat(point)], axis=-1)
    angular = np.concatenate([np.zeros_like(normal), normal], axis=-1)
    return np.concatenate([linear.reshape(N, 3 * K, 6), angular], axis=1)
