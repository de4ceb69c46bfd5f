"""The paper's solver of alignment tasks: normalised gradient descent on the pose of body 2, or of both.

arXiv 2511.06267: the body twist (v, w) of the gradient is scaled to length one as a single 6-vector, then the body
moves by -(v s_t, w s_r). s_r falls from 10 over 1 to 0.1 after 10 % and 90 % of the budget, s_t = s_r / 1000. One
difference: w is the whole derivative of the loss along a rotation, not the half that the paper's projection has,
which solved 94 instead of 92 % of the tasks on convex hulls.
Many pairs of bodies, each with equally many tasks, go through the witness layer together.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from grasp_refine.collision.query import Pairs, Witness
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import body_gradient, retract
from grasp_refine.refinement.terms.contact import contact_targets
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.patch import Patch
from grasp_refine.witness.transport import EquivalentTransport
from grasp_refine_apps.bench.align.aligned import AlignmentResult, errors_at
from grasp_refine_apps.bench.align.bodies import BodyPair
from grasp_refine_apps.bench.align.stopwatch import Stopwatch, TimedDerivative
from grasp_refine_apps.bench.align.tasks import Tasks

SCHEDULE_SHARES, SCHEDULE_FACTORS = (0.1, 0.9), (1.0, 0.1, 0.01)
"""Shares of the budget after which the steps shrink, and the factor of each phase."""

METRES_PER_RADIAN = 1e-3
"""s_t / s_r."""

_ROTATION_FACTOR = 2.0
"""Proj(T^-1 G) has half of the derivative along a rotation; w here is the whole derivative."""


@dataclass(frozen=True)
class AlignDescent:
    """Normalised gradient descent with a fixed schedule."""

    method: Derivative
    """Derivative method of the witness points."""
    transport: bool = True
    """Equivalent gradient transport: the gradient of body 1 acts through body 2."""
    optimise: Literal["T2", "T1T2"] = "T2"
    """Bodies that move."""
    margin: float = 0.0
    """Contact margin beta in metres: the desired gap."""
    step_size: float = 10.0
    """Initial s_r; dimensionless, because the gradient is normalised."""
    iterations: int | None = 2000
    """Budget in iterations; None: `seconds`."""
    seconds: float | None = None
    """Budget in CPU seconds per pair, for all its tasks together."""
    patch: Patch | None = None
    """Patch witness that is used; None: plain witness points."""


def align(
    bodies: Sequence[BodyPair],
    tasks: Sequence[Tasks],
    solver: AlignDescent,
    *,
    dtype: torch.dtype = torch.float64,
    device: str = "cpu",
    progress: Callable[[float], None] = lambda share: None,
) -> AlignmentResult:
    """Run the tasks of several pairs, an equal number of each.

    Args:
        bodies: P pairs.
        tasks: N tasks for each pair.
        solver: Derivative method and schedule.
        dtype: Number type of poses and losses.
        device: Device of poses and losses; queries and derivatives run on the CPU.
        progress: Called from time to time with the share of the budget that is used.
    """

    def stacked(name: str) -> Tensor:
        array = np.stack([getattr(one, name) for one in tasks], axis=1)
        return torch.as_tensor(array, dtype=dtype, device=device)

    watch = Stopwatch()
    pairs = Pairs(tuple(pair.a for pair in bodies), tuple(pair.b for pair in bodies))
    method = TimedDerivative(solver.method, watch)
    layer = WitnessLayer(pairs, method, solver.patch)
    problem = _Problem(solver, layer, stacked("target_a"), stacked("target_b"), watch)
    T_a, T_b = stacked("T_world_a"), stacked("T_world_b")
    best = _Best(torch.full(T_a.shape[:2], torch.inf, dtype=dtype, device=device), T_a, T_b)
    # Caches built at the first call are not part of the loop's time.
    problem.gradients(T_a, T_b, 0, None)
    done, iteration, last = 0.0, 0, None
    start_cpu, start_wall = time.process_time(), time.perf_counter()
    with watch:
        while done < 1.0:
            error, gradients, last = problem.gradients(T_a, T_b, iteration, last)
            best.keep(error, T_a, T_b)
            rotation = solver.step_size * SCHEDULE_FACTORS[sum(done >= share for share in SCHEDULE_SHARES)]
            T_b = _step(T_b, gradients[-1], rotation)
            if solver.optimise == "T1T2":
                T_a = _step(T_a, gradients[0], rotation)
            iteration += 1
            if solver.iterations is not None:
                done = iteration / solver.iterations
            else:
                assert solver.seconds is not None
                done = (time.process_time() - start_cpu) / (solver.seconds * len(bodies))
            if iteration % 50 == 0:
                progress(min(done, 1.0))
    cpu_s, wall_s = time.process_time() - start_cpu, time.perf_counter() - start_wall
    with torch.no_grad():
        last_error, _ = problem.errors(T_a, T_b, iteration)
        best.keep(last_error, T_a, T_b)
    best_error, final_error, last_a, last_b, best_a, best_b = (
        x.double().cpu().numpy() for x in (best.error, last_error, T_a, T_b, best.T_world_a, best.T_world_b)
    )
    if solver.patch is not None:
        # Reported errors are measured by plain witness points.
        final_error = errors_at(bodies, tasks, last_a, last_b, solver.margin)
        best_error = errors_at(bodies, tasks, best_a, best_b, solver.margin)
    iterations = np.full(best_error.shape, iteration)
    return AlignmentResult(best_error, final_error, best_a, best_b, iterations, watch, cpu_s, wall_s)


@dataclass(frozen=True, eq=False)
class _Problem:
    """The errors of all tasks as a function of the poses."""

    solver: AlignDescent
    layer: WitnessLayer
    target_a: Tensor
    """Targets on body b (N, P, 3), metres, body frame."""
    target_b: Tensor
    watch: Stopwatch

    def errors(self, T_a: Tensor, T_b: Tensor, key: int, previous: Witness | None = None) -> tuple[Tensor, Witness]:
        """Return errors (N, P) in square metres, infinite without witness points, and the witness points."""
        with stage("broad phase"):
            found = self.layer(T_a, T_b, self.target_a, self.target_b, key=key, previous=previous)
        residual = contact_targets(found, T_a, T_b, self.target_a, self.target_b, self.solver.margin)
        valid = torch.as_tensor(found.valid, device=residual.device)
        return torch.where(valid, residual.square().sum(dim=-1), torch.inf), found

    def gradients(
        self, T_a: Tensor, T_b: Tensor, key: int, previous: Witness | None
    ) -> tuple[Tensor, tuple[Tensor, ...], Witness | None]:
        """Return errors, their gradients (N, P, 4, 4) in the moving poses, and a witness to speed up the next query."""
        leaves = T_a.detach().requires_grad_(), T_b.detach().requires_grad_()
        seen_a, seen_b = self._transport(*leaves[::-1])[::-1] if self.solver.transport else leaves
        with self.watch.lap("forward"):
            error, found = self.errors(seen_a, seen_b, key, previous)
        with self.watch.lap("backward"):
            gradients = torch.autograd.grad(error.sum(), leaves if self.solver.optimise == "T1T2" else leaves[1:])
        return error.detach(), gradients, found.detached() if self._several else None

    @cached_property
    def _transport(self) -> EquivalentTransport:
        return EquivalentTransport(METRES_PER_RADIAN, _ROTATION_FACTOR, both=self.solver.optimise == "T1T2")

    @cached_property
    def _several(self) -> bool:
        """True where some body has several pieces; otherwise the last answer cannot reorder the pieces."""
        return any(len(body.pieces) > 1 for body in (*self.layer.pairs.a, *self.layer.pairs.b))


@dataclass
class _Best:
    """The best iterate of each task so far."""

    error: Tensor
    """Smallest errors (N, P), in square metres."""
    T_world_a: Tensor
    T_world_b: Tensor

    def keep(self, error: Tensor, T_world_a: Tensor, T_world_b: Tensor) -> None:
        """Keep the iterates that are better; an error that is NaN never is."""
        better = error < self.error
        self.error = torch.where(better, error, self.error)
        self.T_world_a = torch.where(better[..., None, None], T_world_a, self.T_world_a)
        self.T_world_b = torch.where(better[..., None, None], T_world_b, self.T_world_b)


def _step(T: Tensor, G: Tensor, rotation: float) -> Tensor:
    """Return T exp(-(v s_t, w s_r)), with the body twist (v, w) of the gradient G scaled to length one; 0 stays 0."""
    twist = body_gradient(T, G) * T.new_tensor([1.0] * 3 + [_ROTATION_FACTOR] * 3)
    length = twist.norm(dim=-1, keepdim=True)
    unit = twist / torch.where(length > 0, length, torch.ones_like(length))
    scale = twist.new_tensor([METRES_PER_RADIAN * rotation] * 3 + [rotation] * 3)
    return retract(T, -unit * scale)
