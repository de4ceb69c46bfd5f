"""Loop of first-order solvers over a batch: the paper's descent, and Adam."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from torch import Tensor

from grasp_refine.core.array_records import take
from grasp_refine.core.profiling import stage
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.least_squares import IterationCallback, Minimum, Point
from grasp_refine.refinement.solvers.status import Status


@runtime_checkable
class Differentiable(Protocol):
    """Losses of a batch of members with their gradients."""

    lower: Tensor
    """Lower joint limits (n,), within the true ones (see `limits_within`)."""
    upper: Tensor
    """Upper joint limits (n,), likewise."""

    def evaluate(
        self, member: np.ndarray, T: Tensor, q: Tensor, key: int, previous: Any | None
    ) -> tuple[Tensor, Tensor, Any]:
        """Return losses (batch,), gradients (batch, 6 + n), and warm starts: a record with `num_queries` (batch,)."""
        ...

    def tensor(self, array: np.ndarray) -> Tensor:
        """Return an array in the number type and on the device of the problem."""
        ...


def limits_within(lower: np.ndarray, upper: np.ndarray, dtype: torch.dtype, device: str) -> tuple[Tensor, Tensor]:
    """Return joint limits (n,) as tensors, rounded inwards, so that they imply the given ones.

    Where single precision has no number between the two, they are the nearest one.
    """
    low, high = (torch.as_tensor(limit, dtype=dtype, device=device) for limit in (lower, upper))
    beyond = low.double().cpu().numpy() < lower, high.double().cpu().numpy() > upper
    outside = [torch.as_tensor(mask, device=device) for mask in beyond]
    inner_low = torch.where(outside[0], torch.nextafter(low, low.new_tensor(torch.inf)), low)
    inner_high = torch.where(outside[1], torch.nextafter(high, high.new_tensor(-torch.inf)), high)
    ordered = inner_low <= inner_high
    return torch.where(ordered, inner_low, low), torch.where(ordered, inner_high, high)


@stage("solver")
def descend(
    problem: Differentiable,
    start: Point,
    solver: Descent | Adam,
    tolerance: float,
    *,
    status: np.ndarray,
    progress: Callable[[int, int, float], None] | None = None,
    on_iteration: IterationCallback | None = None,
) -> Minimum:
    """Minimise the losses of all members; arguments and result are those of `least_squares.minimise`."""
    run = _Run(problem, start, solver, tolerance, status, on_iteration)
    iteration = 0
    while len(run.active) and iteration < solver.iterations:
        mean_loss = run.iterate(iteration)
        iteration += 1
        if progress is not None:
            progress(len(start.q) - len(run.active), iteration, mean_loss)
    loss = np.stack([run.first, run.best], axis=1)
    return Minimum(Point(run.best_T, run.best_q), loss, run.status, run.iterations, run.queries, run.cpu, run.wall)


class _Run:
    """State of the loop: members that still run, the best iterate of each member, and their cost."""

    def __init__(
        self,
        problem: Differentiable,
        start: Point,
        solver: Descent | Adam,
        tolerance: float,
        status: np.ndarray,
        on_iteration: IterationCallback | None,
    ) -> None:
        count = len(start.q)
        self.problem, self.solver, self.tolerance, self.status = problem, solver, tolerance, status.copy()
        self.on_iteration = on_iteration
        self.best_T, self.best_q = start.T.copy(), start.q.copy()
        self.best, self.first = np.full(count, np.inf), np.full(count, np.nan)
        self.iterations, self.queries = np.zeros((2, count), dtype=np.int64)
        self.wall, self.cpu = np.zeros((2, count))
        self.stage, self.since = np.zeros((2, count), dtype=np.int64)
        self.mark = np.full(count, np.inf)
        self.active = np.flatnonzero(status == Status.RUNNING)
        self.T = problem.tensor(start.T[self.active])
        # A joint at its limit is not beyond it because its value was rounded.
        self.q = problem.tensor(start.q[self.active]).clamp(problem.lower, problem.upper)
        self.memory: Tensor | None = None
        self.previous: Any | None = None

    def iterate(self, iteration: int) -> float:
        """Evaluate and step all running members; return their mean loss."""
        wall, cpu = time.perf_counter(), time.process_time()
        active, problem = self.active, self.problem
        loss, gradient, known = problem.evaluate(active, self.T, self.q, iteration, self.previous)
        value = loss.double().cpu().numpy()
        if self.on_iteration is not None:
            self.on_iteration(active, Point(self.T.double().cpu().numpy(), self.q.double().cpu().numpy()), value)
        ended = self._judge(value, iteration)
        stage = torch.as_tensor(self.stage[active], device=self.T.device)
        memory = self.solver.memory(gradient) if self.memory is None else self.memory
        T, q, memory = self.solver.step(self.T, self.q, gradient, memory, stage, problem.lower, problem.upper)
        self.iterations[active] += 1
        self.queries[active] += known.num_queries
        if ended.any():
            keep = np.flatnonzero(~ended)
            rows = torch.as_tensor(keep, device=self.T.device)
            T, q, memory = T[rows], q[rows], memory[rows]
            self.active, known = active[keep], take(known, keep)
        self.T, self.q, self.memory, self.previous = T, q, memory, known
        share = 1.0 / len(active)
        self.wall[active] += (time.perf_counter() - wall) * share
        self.cpu[active] += (time.process_time() - cpu) * share
        finite = value[np.isfinite(value)]
        return float(finite.mean()) if len(finite) else 0.0

    def _judge(self, value: np.ndarray, iteration: int) -> np.ndarray:
        """Keep the best iterates, advance the schedule, and return which members end here (active,)."""
        solver, active = self.solver, self.active
        if iteration == 0:
            self.first[active] = value
        better = value < self.best[active]
        index = active[better]
        self.best[index] = value[better]
        self.best_T[index] = self.T.double().cpu().numpy()[better]
        self.best_q[index] = self.q.double().cpu().numpy()[better]
        progressed = value < (1.0 - solver.progress) * self.mark[active]
        self.mark[active] = np.where(progressed, value, self.mark[active])
        self.since[active] = np.where(progressed, 0, self.since[active] + 1)
        stuck = self.since[active] >= solver.patience
        last = self.stage[active] == len(solver.factors)
        self.stage[active] = np.maximum(self.stage[active] + (stuck & ~last), solver.first_stage(iteration))
        self.since[active] = np.where(stuck, 0, self.since[active])
        converged, failed = value < self.tolerance, ~np.isfinite(value)
        out_of_budget = np.full(len(active), iteration + 1 >= solver.iterations)
        ends = (
            (out_of_budget, Status.BUDGET),
            (stuck & last, Status.STALLED),
            (converged, Status.CONVERGED),
            (failed, Status.NOT_FINITE),
        )
        for mask, status in ends:
            self.status[active[mask]] = status
        return np.logical_or.reduce([mask for mask, _ in ends])
