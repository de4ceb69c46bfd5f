"""Staying near: the grasp moves little from where it began."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from grasp_refine.core.se3 import Array, array_namespace, hat, log_so3
from grasp_refine.hands.inverse_kinematics import ArmKinematics
from grasp_refine.hands.palm import palm_poses
from grasp_refine.refinement.solvers.rows import JointRows
from grasp_refine.refinement.terms.scales import Scales
from grasp_refine.refinement.terms.term import Setup, State, Term


class StayNear(Term):
    """Movements of palm and joints from the initial grasp, in units of `Scales`; an arm's joints move freely."""

    def prepare(self, setup: Setup) -> None:
        """Find the palms of the initial grasps, where an arm carries them."""
        scene = setup.scene
        self.T_palm = palm_poses(scene.hand, scene.T_world_root, scene.q)
        self.arm = None if scene.hand.arm is None else ArmKinematics(scene.hand)
        self.own = ~scene.hand.arm_joints

    def residuals(self, state: State) -> tuple[Array, ...]:
        """Return the movements (M, 6 + k) of palm and joints without the arm."""
        scene, member, scales = self.setup.scene, state.member, self.setup.scales
        T_first, q_first = state.like(self.T_palm[member]), state.like(scene.q[member])
        per_radian = state.like(scene.hand.per_radian)
        if self.arm is None:
            return (movement(state.T, state.q, T_first, q_first, scales, per_radian),)
        T, own = self.arm.palm(state.T, state.q), self.own
        return (movement(T, state.q[:, own], T_first, q_first[:, own], scales, per_radian[own]),)

    def rows(self, state: State, width: np.ndarray) -> Iterator[JointRows]:
        """Return rows of all movements."""
        (away,) = self.residuals(state)
        jacobian = movement_jacobian(away, self.setup.scales, self.setup.scene.hand.per_radian[self.own])
        if self.arm is not None:
            _, J = self.arm.jacobian(state.T, state.q)
            moves = np.zeros((len(away), jacobian.shape[2], 6 + state.q.shape[1]))
            moves[:, :6, 6 + self.arm.joints] = J
            moves[:, np.arange(6, jacobian.shape[2]), 6 + np.flatnonzero(self.own)] = 1.0
            jacobian = jacobian @ moves
        yield JointRows(away, jacobian)


def movement(T: Array, q: Array, T_first: Array, q_first: Array, scales: Scales, per_radian: Array) -> Array:
    """Return the movement (..., 6 + n) from the initial root pose and joint values, in units of `scales`.

    [(p - p_0) / s_t, log(R R_0^T) / s_r, (q - q_0) / (s_q u)], world frame, with u = `per_radian` of the hand.
    """
    xp = array_namespace(q)
    turned = log_so3(T[..., :3, :3] @ xp.matrix_transpose(T_first[..., :3, :3]))
    moved = T[..., :3, 3] - T_first[..., :3, 3]
    joints = (q - q_first) / (scales.joints * per_radian)
    return xp.concat([moved / scales.translation, turned / scales.rotation, joints], axis=-1)


def movement_jacobian(residual: np.ndarray, scales: Scales, per_radian: np.ndarray) -> np.ndarray:
    """Return the derivative (..., 6 + n, 6 + n) of `movement` in (v, w, q), the root turning about its own origin.

    Exact except for the rotation, d log = J_l^-1(log) w, taken to second order of the angle: I - [w] / 2 + [w]^2 / 12.
    """
    n = residual.shape[-1] - 6
    each = np.concatenate([np.repeat([scales.translation, scales.rotation], 3), scales.joints * per_radian])
    jacobian = np.zeros((*residual.shape, 6 + n)) + np.diag(1.0 / each)
    w = residual[..., 3:6] * scales.rotation
    W = hat(w)
    jacobian[..., 3:6, 3:6] += (-0.5 * W + W @ W / 12.0) / scales.rotation
    return jacobian
