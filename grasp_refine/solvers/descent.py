"""Normalised gradient descent, the solver of arXiv 2511.06267 in its grasp application."""

from dataclasses import dataclass

import torch
from torch import Tensor

from grasp_refine.se3 import retract


@dataclass(frozen=True)
class Descent:
    """Fixed-length steps against the gradient: root translation, root rotation and joints each on their own.

    T <- T exp(-(v s_t, w s_r)) with the body twist (v, w) of the gradient, v and w of unit length, and
    q <- q - s_q g / |g|. The lengths shrink by the `factors` after the given `shares` of the iterations, or
    earlier for a grasp whose loss no longer falls.
    """

    iterations: int = 2000
    """Most iterations per grasp."""
    step_translation: float = 1e-3
    """s_t in metres."""
    step_rotation: float = 1e-2
    """s_r in radians (the paper takes 0.002)."""
    step_joints: float = 2e-2
    """s_q in radians, metres for prismatic joints (the paper takes 0.01)."""
    shares: tuple[float, ...] = (0.5, 0.8)
    """Shares of the iterations after which the steps shrink."""
    factors: tuple[float, ...] = (0.1, 0.01)
    """What the steps shrink to then."""
    patience: int = 200
    """Iterations without progress after which a grasp goes on with shorter steps, or ends after the last."""
    progress: float = 0.01
    """Smallest relative fall of the loss that counts as progress."""
    transport: bool = False
    """Equivalent gradient transport: the object's gradient acts through the links (not a gradient any more)."""

    def first_stage(self, iteration: int) -> int:
        """The earliest stage of the schedule at an iteration."""
        return sum(iteration >= share * self.iterations for share in self.shares)

    def step(
        self,
        T: Tensor,
        q: Tensor,
        twist: Tensor,
        q_gradient: Tensor,
        stage: Tensor,
        lower: Tensor,
        upper: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """The next root poses and joint values.

        Args:
            T: Root poses (batch, 4, 4).
            q: Joint values (batch, n).
            twist: Gradient (v, w) at the root as a body twist (batch, 6).
            q_gradient: Gradient of the joint values (batch, n).
            stage: Stage of the schedule of each grasp (batch,).
            lower: Lower joint limits (n,); a joint within its limits never leaves them.
            upper: Upper joint limits (n,).
        """
        scale = T.new_tensor((1.0, *self.factors))[stage][:, None]
        v, w = _unit(twist[:, :3]), _unit(twist[:, 3:])
        move = torch.cat([-v * self.step_translation, -w * self.step_rotation], dim=1) * scale
        moved = q - _unit(q_gradient) * self.step_joints * scale
        return retract(T, move), torch.minimum(
            torch.maximum(moved, torch.minimum(q, lower)), torch.maximum(q, upper)
        )


def _unit(vector: Tensor) -> Tensor:
    """Vectors (batch, n) at unit length; zero stays zero."""
    norm = vector.norm(dim=1, keepdim=True)
    return torch.where(
        norm > 0, vector / torch.where(norm > 0, norm, torch.ones_like(norm)), torch.zeros_like(vector)
    )
