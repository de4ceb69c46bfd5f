"""The paper's solver of alignment tasks: normalised gradient descent on the pose of body 2, or of both.

arXiv 2511.06267: the body twist (v, w) of the gradient is scaled to length one as a single 6-vector, then the body
moves by -(v s_t, w s_r). s_r falls from 10 over 1 to 0.1 after 10 % and 90 % of the budget, s_t = s_r / 1000. As in the
paper's projection Proj(T^-1 G), w is half of the derivative of the loss along a rotation: with all of it the last
iterates of large bodies swing by more than a tenth of a millimetre.
Many pairs of bodies, each with equally many tasks, go through the witness layer together.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from grasp_refine.collision.query import Pairs, Witness
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import body_gradient, retract
from grasp_refine.refinement.terms.contact import contact_targets
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.transport import EquivalentTransport
from grasp_refine_apps.bench.align.aligned import AlignmentResult, errors_at
from grasp_refine_apps.bench.align.bodies import BodyPair
from grasp_refine_apps.bench.align.patch import PatchLayer
from grasp_refine_apps.bench.align.stopwatch import Stopwatch, TimedDerivative
from grasp_refine_apps.bench.align.tasks import Tasks
from grasp_refine_apps.bench.align.variants import Variant

SCHEDULE_SHARES, SCHEDULE_FACTORS = (0.1, 0.9), (1.0, 0.1, 0.01)
"""Shares of the budget after which the steps shrink, and the factor of each phase."""

METRES_PER_RADIAN = 1e-3
"""s_t / s_r."""


def align(
    bodies: Sequence[BodyPair],
    tasks: Sequence[Tasks],
    variant: Variant,
    *,
    seed: int = 0,
    dtype: torch.dtype = torch.float64,
    device: str = "cpu",
    progress: Callable[[float], None] = lambda share: None,
) -> AlignmentResult:
    """Run the tasks of several pairs, an equal number of each.

    Args:
        bodies: P pairs.
        tasks: N tasks for each pair.
        variant: Derivative method, schedule and budget.
        seed: Seed of the derivative method.
        dtype: Number type of poses and losses.
        device: Device of poses and losses; queries and derivatives run on the CPU.
        progress: Called from time to time with the share of the budget that is used.
    """

    def stacked(name: str) -> Tensor:
        array = np.stack([getattr(one, name) for one in tasks], axis=1)
        return torch.as_tensor(array, dtype=dtype, device=device)

    watch = Stopwatch()
    pairs = Pairs(tuple(pair.a for pair in bodies), tuple(pair.b for pair in bodies))
    method = TimedDerivative(variant.derivative(seed), watch)
    patch = variant.solver_patch
    layer = WitnessLayer(pairs, method) if patch is None else PatchLayer(pairs, method, patch)
    problem = _Problem(variant, layer, stacked("target_a"), stacked("target_b"), watch)
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
            rotation = variant.step_size * SCHEDULE_FACTORS[sum(done >= share for share in SCHEDULE_SHARES)]
            T_b = _step(T_b, gradients[-1], rotation)
            if variant.optimise == "T1T2":
                T_a = _step(T_a, gradients[0], rotation)
            iteration += 1
            if variant.budget is not None:
                done = iteration / variant.budget
            else:
                assert variant.budget_s is not None
                # A budget is for all targets of a pair.
                done = (time.process_time() - start_cpu) / (variant.budget_s / variant.every * len(bodies))
            if iteration % 50 == 0:
                progress(min(done, 1.0))
    cpu_s, wall_s = time.process_time() - start_cpu, time.perf_counter() - start_wall
    with torch.no_grad():
        last_error, _ = problem.errors(T_a, T_b, iteration)
        best.keep(last_error, T_a, T_b)
    best_error, final_error, last_a, last_b, best_a, best_b = (
        x.double().cpu().numpy() for x in (best.error, last_error, T_a, T_b, best.T_world_a, best.T_world_b)
    )
    if variant.solver_patch is not None:
        # Reported errors are measured by plain witness points.
        final_error = errors_at(bodies, tasks, last_a, last_b, variant.margin)
        best_error = errors_at(bodies, tasks, best_a, best_b, variant.margin)
    iterations = np.full(best_error.shape, iteration)
    return AlignmentResult(best_error, final_error, best_a, best_b, iterations, watch, cpu_s, wall_s)


@dataclass(frozen=True, eq=False)
class _Problem:
    """The errors of all tasks as a function of the poses."""

    variant: Variant
    layer: WitnessLayer
    target_a: Tensor
    """Target points (N, P, 3) of body a, metres, frame of body a."""
    target_b: Tensor
    """Likewise of body b."""
    watch: Stopwatch

    def errors(self, T_a: Tensor, T_b: Tensor, key: int, previous: Witness | None = None) -> tuple[Tensor, Witness]:
        """Return errors (N, P) in square metres, infinite without witness points, and the witness points."""
        with stage("broad phase"):
            found = self.layer(T_a, T_b, self.target_a, self.target_b, key=key, previous=previous)
        residual = contact_targets(found, T_a, T_b, self.target_a, self.target_b, self.variant.margin)
        valid = torch.as_tensor(found.valid, device=residual.device)
        return torch.where(valid, residual.square().sum(dim=-1), torch.inf), found

    def gradients(
        self, T_a: Tensor, T_b: Tensor, key: int, previous: Witness | None
    ) -> tuple[Tensor, tuple[Tensor, ...], Witness | None]:
        """Return errors, their gradients (N, P, 4, 4) in the moving poses, and a witness to speed up the next query."""
        leaves = T_a.detach().requires_grad_(), T_b.detach().requires_grad_()
        seen_a, seen_b = self._transport(*leaves[::-1])[::-1] if self.variant.transport else leaves
        with self.watch.lap("forward"):
            error, found = self.errors(seen_a, seen_b, key, previous)
        with self.watch.lap("backward"):
            gradients = torch.autograd.grad(error.sum(), leaves if self.variant.optimise == "T1T2" else leaves[1:])
        return error.detach(), gradients, found.detached() if self._several else None

    @cached_property
    def _transport(self) -> EquivalentTransport:
        return EquivalentTransport(METRES_PER_RADIAN, 1.0, both=self.variant.optimise == "T1T2")

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
    twist = body_gradient(T, G)
    length = twist.norm(dim=-1, keepdim=True)
    unit = twist / torch.where(length > 0, length, torch.ones_like(length))
    scale = twist.new_tensor([METRES_PER_RADIAN * rotation] * 3 + [rotation] * 3)
    return retract(T, -unit * scale)
