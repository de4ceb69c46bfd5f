"""Normalised gradient descent, the solver of arXiv 2511.06267 in its grasp application."""

from dataclasses import dataclass

import torch
from torch import Tensor

from grasp_refine.errors import GraspRefineError
from grasp_refine.se3 import retract


@dataclass(frozen=True)
class Descent:
    """Fixed-length steps against the gradient: root translation, root rotation and joints each on their own.

    T <- T exp(-(v s_t, w s_r)) with the body twist (v, w) of the averaged gradient, v and w of unit length, and
    q <- q - s_q g / |g|. The lengths shrink by the `factors` after the given `shares` of the iterations, or
    earlier for a grasp whose loss no longer falls. The paper's schedule has no momentum; with it, contacts that
    roll or slide settle in about a quarter of the iterations.
    """

    iterations: int = 2000
    """Most iterations per grasp."""
    step_translation: float = 1e-3
    """s_t in metres."""
    step_rotation: float = 1e-2
    """s_r in radians (the paper takes 0.002)."""
    step_joints: float = 2e-2
    """s_q in radians, metres for prismatic joints (the paper takes 0.01)."""
    momentum: float = 0.9
    """Share of the last average in the averaged gradient; 0 is the paper's descent."""
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

    def __post_init__(self) -> None:
        """Refuse a schedule that cannot run.

        Raises:
            GraspRefineError: momentum outside [0, 1), or not one factor for each share.
        """
        if not 0.0 <= self.momentum < 1.0:
            raise GraspRefineError(f"descent: momentum must be at least 0 and below 1, got {self.momentum:g}")
        if len(self.shares) != len(self.factors):
            raise GraspRefineError(
                f"descent: shares and factors belong together, got {len(self.shares)} and {len(self.factors)} numbers"
            )

    def first_stage(self, iteration: int) -> int:
        """The earliest stage of the schedule at an iteration."""
        return sum(iteration >= share * self.iterations for share in self.shares)

    def step(
        self,
        T: Tensor,
        q: Tensor,
        gradient: Tensor,
        average: Tensor,
        stage: Tensor,
        lower: Tensor,
        upper: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """The next root poses, joint values and averaged gradients.

        Args:
            T: Root poses (batch, 4, 4).
            q: Joint values (batch, n).
            gradient: Gradient (batch, 6 + n): the root's as a body twist (v, w), then that of the joint values.
            average: Averaged gradient of the last step (batch, 6 + n); zero at first.
            stage: Stage of the schedule of each grasp (batch,).
            lower: Lower joint limits (n,); a joint within its limits never leaves them.
            upper: Upper joint limits (n,).
        """
        average = self.momentum * average + (1.0 - self.momentum) * gradient
        scale = T.new_tensor((1.0, *self.factors))[stage][:, None]
        v, w, g = _unit(average[:, :3]), _unit(average[:, 3:6]), _unit(average[:, 6:])
        moved_T = retract(T, torch.cat([-v * self.step_translation, -w * self.step_rotation], dim=1) * scale)
        moved_q = q - g * self.step_joints * scale
        moved_q = torch.minimum(torch.maximum(moved_q, torch.minimum(q, lower)), torch.maximum(q, upper))
        return moved_T, moved_q, average


def _unit(vector: Tensor) -> Tensor:
    """Vectors (batch, n) at unit length; zero stays zero."""
    norm = vector.norm(dim=1, keepdim=True)
    return torch.where(norm > 0, vector / torch.where(norm > 0, norm, torch.ones_like(norm)), torch.zeros_like(vector))
