"""Single steps of first-order solvers, from gradients that are given."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from grasp_refine.refinement.solvers.first_order import Descending, FirstOrder
from grasp_refine.refinement.solvers.iterate import Point, Slots


@dataclass(frozen=True, eq=False)
class Given:
    """A problem of which only the joint limits are known."""

    lower: torch.Tensor
    upper: torch.Tensor
    per_radian: torch.Tensor

    def tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(array, dtype=self.lower.dtype)


@dataclass(frozen=True, eq=False)
class Known:
    gradient: np.ndarray


def first_state(solver: FirstOrder, point: Point, phase: np.ndarray | int = 0) -> Descending:
    """The state before the first step, in a phase of the schedule."""
    count = len(point.q)
    return Descending(np.zeros(count, dtype=np.int64) + phase, solver.initial_memory(count, 6 + point.q.shape[1]))


def one_step(
    solver: FirstOrder,
    point: Point,
    gradient: np.ndarray,
    state: Descending,
    lower: np.ndarray | float = -np.inf,
    upper: np.ndarray | float = np.inf,
    dtype: torch.dtype = torch.float64,
    per_radian: np.ndarray | float = 1.0,
) -> tuple[Point, Descending]:
    """Points and state after a step against a gradient (batch, 6 + n), within joint limits."""
    count, n = point.q.shape
    problem = Given(
        *(torch.as_tensor(np.broadcast_to(side, n).copy(), dtype=dtype) for side in (lower, upper, per_radian))
    )
    none = np.zeros(count)
    slots = Slots(np.arange(count), point, Known(gradient), none, point, none, none, none, state)
    after, state = solver.step(problem, slots)
    return after, replace(state)
