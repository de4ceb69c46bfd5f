"""Normalised gradient descent, the solver of arXiv 2511.06267 in its grasp application."""

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
class Descent(FirstOrder):
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

    def initial_memory(self, count: int, dof: int) -> np.ndarray:
        """Return a zero average."""
        return np.zeros((count, dof))

    def direction(self, gradient: torch.Tensor, memory: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the averaged gradient, each of its three parts of unit length, and the average itself."""
        average = self.momentum * memory + (1.0 - self.momentum) * gradient
        unit = average.clone()
        for part in (slice(0, 3), slice(3, 6), slice(6, None)):
            unit[:, part] = _unit(average[:, part])
        return unit, average


def _unit(vector: torch.Tensor) -> torch.Tensor:
    """Return vectors (batch, n) scaled to unit length; zero stays zero."""
    norm = vector.norm(dim=1, keepdim=True)
    return vector / norm.where(norm > 0, norm.new_ones(()))
