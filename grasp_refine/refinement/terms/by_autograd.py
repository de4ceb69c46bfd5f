"""Rows of residuals with derivatives by autograd."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from grasp_refine.refinement.solvers.rows import JointRows
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics


def rows_by_autograd(residuals: Callable[[Any], tuple[Any, ...]], state: Any, prepared: HandObject) -> JointRows:
    """Return all residuals of M grasps with their derivatives in root twist and joint values.

    Poses of links and witness points are differentiated as far as the residuals, by one backward pass for each of R
    residuals; from there on by the geometric Jacobian of the hand. Witness points slide by contact kinematics.

    Args:
        residuals: Residuals of a term, written for tensors.
        state: State of M grasps, in NumPy arrays.
        prepared: Geometry of hand and object.
    """
    T, q, T_link = (torch.as_tensor(part).clone().requires_grad_() for part in (state.T, state.q, state.T_link))
    T_object = torch.eye(4, dtype=T_link.dtype).expand(T_link.shape)
    witness = WitnessLayer(prepared.pairs, ContactKinematics()).known(T_link, T_object, state.witness)
    on_graph = replace(state, T=T, q=q, T_link=T_link, witness=witness, T_object=T_object)
    count, links = T_link.shape[:2]
    residual = torch.cat([one.reshape(count, -1) for one in residuals(on_graph)], dim=1)
    jacobian = np.zeros((*residual.shape, 6 + q.shape[1]))
    if not residual.requires_grad:
        return JointRows(residual.numpy(), jacobian)
    for row in range(residual.shape[1]):
        G_link, G, g = torch.autograd.grad(
            residual[:, row].sum(), (T_link, T, q), retain_graph=True, allow_unused=True
        )  # fmt: skip
        if G_link is not None:
            covector = _covectors(state.T_link, G_link)
            jacobian[:, row] += prepared.chain.to_joint_space(state.frames, covector, np.arange(links)).sum(axis=1)
        if G is not None:
            covector = _covectors(state.T, G)
            jacobian[:, row, :6] += (covector[:, None] @ state.axes[:, :, :6])[:, 0]
        if g is not None:
            jacobian[:, row, 6:] += g.numpy()
    return JointRows(residual.detach().numpy(), jacobian)


def _covectors(T: np.ndarray, gradient: Tensor) -> np.ndarray:
    """Return the covectors (..., 6) on spatial twists of gradients (..., 4, 4) in the entries of poses."""
    G = gradient.double().numpy()
    force = G[..., :3, 3]
    turning = G[..., :3, :3] @ T[..., :3, :3].swapaxes(-1, -2)
    skew = turning - turning.swapaxes(-1, -2)
    moment = np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)
    return np.concatenate([force, moment + np.cross(T[..., :3, 3], force)], axis=-1)
