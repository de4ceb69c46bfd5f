"""Equivalent gradient transport (arXiv 2511.06267): both bodies' gradients act through the one that moves.

A pair's loss depends on the relative pose T_a^-1 T_b, so moving body b by exp(-xi_b) is equivalent to moving
body a by exp(-xi~_a) with xi~_a = -Ad(T_a^-1 T_b) xi_b:

    (T_a exp(-xi~_a))^-1 T_b = T_a^-1 (T_b exp(-xi_b)).

It transports *updates*: the gradient of b is scaled by the step sizes (s_t, s_r), transported, unscaled, and added
to the gradient of a. Where both bodies move, each gets the other's update in addition to its own, so that, to first
order, the relative pose moves twice as far. The sum is a descent direction that is no longer the derivative of
the loss; it is an option of gradient descent only. Gradients are body twists Proj(T^-1 G)
(`se3.body_gradient`). The poses may be results themselves, for example of a kinematic chain: their gradients
flow on to the root and the joints.
"""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from grasp_refine.core.arguments import check_fields
from grasp_refine.core.se3 import body_gradient, cross, hat, matvec


@dataclass(frozen=True)
class EquivalentTransport:
    """Addition of the resting body's transported gradient to the moving body's, or of each to the other."""

    step_translation: float
    """Step s_t in metres per unit of linear gradient."""
    step_rotation: float
    """Step s_r in radians per unit of angular gradient."""
    both: bool = False
    """Whether the body called resting moves too, with the same step sizes, and also gets the other's gradient."""

    def __post_init__(self) -> None:
        """Refuse settings of other types."""
        check_fields(self)

    def __call__(self, T_world_moving: Tensor, T_world_resting: Tensor) -> tuple[Tensor, Tensor]:
        """Return the poses (..., 4, 4) unchanged, with their gradients transported in the backward pass."""
        return _Transport.apply(T_world_moving, T_world_resting, self)


def transport(T_from: Tensor, T_to: Tensor, twist: Tensor) -> Tensor:
    """Body twist -Ad(T_to^-1 T_from) xi (..., 6) of body `to`, equivalent to the update xi of body `from`.

    It is the same motion in world axes, about the other origin: v + w x (p_to - p_from).
    """
    v, w = (T_from[..., :3, :3] @ torch.stack([twist[..., :3], twist[..., 3:]], dim=-1)).unbind(-1)
    v = v + cross(w, T_to[..., :3, 3] - T_from[..., :3, 3])
    moved = T_to[..., :3, :3].mT @ torch.stack([v, w], dim=-1)
    return -moved.mT.flatten(-2)


class _Transport(torch.autograd.Function):
    """Identity on poses; its backward pass transports the gradient of one body to the other."""

    @staticmethod
    def forward(ctx: Any, T_moving: Tensor, T_resting: Tensor, steps: EquivalentTransport) -> tuple[Tensor, Tensor]:
        ctx.save_for_backward(T_moving, T_resting)
        ctx.steps = steps
        return T_moving.view_as(T_moving), T_resting.view_as(T_resting)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, G_moving: Tensor, G_resting: Tensor) -> tuple[Tensor, Tensor, None]:
        T_moving, T_resting = ctx.saved_tensors
        scale = T_moving.new_tensor([ctx.steps.step_translation] * 3 + [ctx.steps.step_rotation] * 3)

        def transported(T_from: Tensor, G_from: Tensor, T_to: Tensor) -> Tensor:
            return _entries(T_to, transport(T_from, T_to, body_gradient(T_from, G_from) * scale) / scale)

        for_moving = G_moving + transported(T_resting, G_resting, T_moving)
        for_resting = G_resting + transported(T_moving, G_moving, T_resting) if ctx.steps.both else G_resting
        return for_moving, for_resting, None


def _entries(T: Tensor, twist: Tensor) -> Tensor:
    """Entry-wise gradient (..., 4, 4) with Proj(T^-1 G) = twist: the inverse of `se3.body_gradient`."""
    R = T[..., :3, :3]
    G = torch.zeros_like(T)
    G[..., :3, :3] = R @ hat(twist[..., 3:])
    G[..., :3, 3] = matvec(R, twist[..., :3])
    return G
