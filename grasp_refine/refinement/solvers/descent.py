"""Normalised gradient descent, the solver of arXiv 2511.06267 in its grasp application."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.refinement.solvers.schedule import Schedule

if TYPE_CHECKING:
    # It takes seconds to load, and options are made of this class.
    import torch


@dataclass(frozen=True)
class Descent(Schedule):
    """Fixed-length steps against the gradient: root translation, root rotation and joints each on their own.

    T <- T exp(-(v s_t, w s_r)) with the body twist (v, w) of the averaged gradient, v and w of unit length, and
    q <- q - s_q g / |g|. The paper's schedule has no momentum; with it, contacts that roll or slide settle in about
    a quarter of the iterations.
    """

    momentum: float = 0.9
    """Share of the last average in the averaged gradient; 0 is the paper's descent."""

    def __post_init__(self) -> None:
        """Refuse a schedule that cannot run.

        Raises:
            GraspRefineError: momentum outside [0, 1), or not one factor per share.
        """
        super().__post_init__()
        if not 0.0 <= self.momentum < 1.0:
            raise GraspRefineError(f"descent: momentum must be at least 0 and below 1, got {self.momentum:g}")

    def memory(self, gradient: torch.Tensor) -> torch.Tensor:
        """Return the initial memory: a zero average."""
        return gradient.new_zeros(gradient.shape)

    def step(
        self,
        T: torch.Tensor,
        q: torch.Tensor,
        gradient: torch.Tensor,
        memory: torch.Tensor,
        stage: torch.Tensor,
        lower: torch.Tensor,
        upper: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return the next root poses, joint values and averaged gradients.

        Args:
            T: Root poses (batch, 4, 4).
            q: Joint values (batch, n).
            gradient: Gradient (batch, 6 + n): the root's as a body twist (v, w), then that of the joint values.
            memory: Averaged gradient of the last step (batch, 6 + n); zero at first.
            stage: Stage of the schedule of each grasp (batch,).
            lower: Lower joint limits (n,); a joint within its limits never leaves them.
            upper: Upper joint limits (n,).
        """
        average = self.momentum * memory + (1.0 - self.momentum) * gradient
        unit = average.clone()
        for part in (slice(0, 3), slice(3, 6), slice(6, None)):
            unit[:, part] = _unit(average[:, part])
        return *self.integrate(T, q, unit, stage, lower, upper), average


def _unit(vector: torch.Tensor) -> torch.Tensor:
    """Return vectors (batch, n) scaled to unit length; zero stays zero."""
    norm = vector.norm(dim=1, keepdim=True)
    return vector / norm.where(norm > 0, norm.new_ones(()))
