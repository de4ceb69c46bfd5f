"""Adam (Kingma and Ba 2015) on root pose and joint values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.refinement.solvers.first_order import FirstOrder

if TYPE_CHECKING:
    # It takes seconds to load, and options are made of this class.
    import torch


@dataclass(frozen=True)
class Adam(FirstOrder):
    """Steps along the averaged gradient, each component over the root of its averaged square.

    The root's components form its body twist. A component whose gradient keeps its sign moves by a whole
    step length in each iteration.
    """

    first: float = 0.9
    """beta_1: share of the last average in the averaged gradient."""
    second: float = 0.99
    """beta_2: share of the last average in the averaged squares."""

    def __post_init__(self) -> None:
        """Refuse averages that do not decay.

        Raises:
            GraspRefineError: beta_1 or beta_2 outside [0, 1), or not one factor per share.
        """
        super().__post_init__()
        if not (0.0 <= self.first < 1.0 and 0.0 <= self.second < 1.0):
            raise GraspRefineError(
                f"adam: first and second must be at least 0 and below 1, got {self.first:g} and {self.second:g}"
            )

    def initial_memory(self, count: int, dof: int) -> np.ndarray:
        """Return zero averages of gradient and squares, and zero steps."""
        return np.zeros((count, 2 * dof + 1))

    def direction(self, gradient: torch.Tensor, memory: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the averaged gradient over the root of the averaged squares, and averages and number of steps."""
        import torch

        dof = gradient.shape[1]
        average = self.first * memory[:, :dof] + (1.0 - self.first) * gradient
        squares = self.second * memory[:, dof : 2 * dof] + (1.0 - self.second) * gradient.square()
        steps = memory[:, 2 * dof :] + 1.0
        mean = average / (1.0 - self.first**steps)
        size = (squares / (1.0 - self.second**steps)).sqrt()
        direction = torch.where(size > 0, mean / torch.where(size > 0, size, torch.ones_like(size)), 0.0)
        return direction, torch.cat([average, squares, steps], dim=1)
