"""Normalised gradient descent on the pose of body 2, or of both, in short runs.

Directions and first steps are those of arXiv 2511.06267: the body twist (v, w) of the gradient is scaled to length one
as a single 6-vector, then the body moves by -(v s_t, w s_r). s_r falls from 10 over 1 to 0.1 after 10 % and 90 % of a
run, s_t = s_r / 1000. As in the paper's projection Proj(T^-1 G), w is half of the derivative of the loss along a
rotation: with all of it the last iterates of large bodies swing by more than a tenth of a millimetre.

The paper makes one run of the whole budget and takes its last iterate. On concave bodies such a run ends where two
pairs of pieces are equally close: each step makes the other one the closest, and the error jumps to and fro by
millimetres for the rest of the budget. Therefore, here

- a run is short, and its last phase starts at its best pose, with steps that shrink where the error rises;
- the next run starts far from the last pose, or near the best one, in turn, until a task is solved;
- the result is the best pose of all runs.

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
from grasp_refine.core.se3 import body_gradient, retract, transform_points
from grasp_refine.refinement.terms.contact import contact_targets
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.transport import EquivalentTransport
from grasp_refine_apps.bench.align.aligned import AlignmentResult, errors_at
from grasp_refine_apps.bench.align.bodies import BodyPair
from grasp_refine_apps.bench.align.closed_form import turned
from grasp_refine_apps.bench.align.patch import PatchLayer
from grasp_refine_apps.bench.align.restarts import generator, random_rotation
from grasp_refine_apps.bench.align.stopwatch import Stopwatch, TimedDerivative
from grasp_refine_apps.bench.align.tasks import Tasks
from grasp_refine_apps.bench.align.variants import Variant

FIRST_ITERATIONS, RUN_ITERATIONS = 200, 60
"""Lengths of the first run and of all others."""

PHASE_STARTS, STEP_FACTORS = (0.1, 0.9), (1.0, 0.1, 0.01)
"""Shares of a run at which its second and third phase start, and the factor of s_r in each phase."""

SHRINKING, GROWTH = 0.5, 1.5
"""Factors of the steps of the third phase: where the error did not fall, and where it fell."""

SOLVED_M2 = 1e-8
"""Error in square metres below which a task stays in the third phase, without another start."""

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
        seed: Seed of the derivative method and of starts.
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
    T = stacked("T_world_a"), stacked("T_world_b")
    initial = T[1].double().cpu().numpy()
    unknown = torch.full(T[0].shape[:2], torch.inf, dtype=dtype, device=device)
    best = here = _Best(unknown, T)
    step, solved = torch.zeros_like(unknown), torch.zeros_like(unknown, dtype=torch.bool)
    # Caches built at the first call are not part of the loop's time.
    problem.gradients(*T, 0, None)
    done, iteration, phase, last = 0.0, 0, 0, None
    first = min(FIRST_ITERATIONS, variant.budget or FIRST_ITERATIONS)
    start_cpu, start_wall = time.process_time(), time.perf_counter()
    with watch:
        while done < 1.0:
            run, position, length = _run_at(iteration, first)
            before, phase = phase, sum(position >= share * length for share in PHASE_STARTS)
            if position == 0:
                solved = best.error < SOLVED_M2
                if run:
                    away = _restarted(T if _is_far(run) else best.kept, problem, initial, seed, run)
                    T_a, T_b = _where(solved, best.kept, away)
                    T, last = (T_a, T_b), None
            error, gradients, last = problem.gradients(*T, iteration, last)
            best.keep(error, T)
            units = _unit_twists(T, gradients)
            if position == 0:
                here = _Best(unknown, (*T, *units))
            fell = here.keep(error, (*T, *units))
            begins = (position == 0) | ((before < phase == len(PHASE_STARTS)) & ~solved)
            step = torch.where(begins, STEP_FACTORS[-1], step * torch.where(fell, GROWTH, SHRINKING))
            # The third phase of a run, and every phase of a solved task, searches from the best pose of the run.
            search = solved | (phase == len(PHASE_STARTS))
            size = torch.where(search, step, STEP_FACTORS[phase if _is_far(run) else max(phase, 1)])
            T_a, T_b, *along = _where(search, here.kept, (*T, *units))
            size = variant.step_size * size[..., None]
            T = T_a if len(along) == 1 else _step(T_a, along[0], size), _step(T_b, along[-1], size)
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
        best.keep(problem.errors(*T, iteration)[0], T)
    found, best_a, best_b = (x.double().cpu().numpy() for x in (best.error, *best.kept))
    if variant.solver_patch is not None:
        # Reported errors are measured by plain witness points.
        found = errors_at(bodies, tasks, best_a, best_b, variant.margin)
    return AlignmentResult(found, best_a, best_b, np.full(found.shape, iteration), watch, cpu_s, wall_s)


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
    kept: tuple[Tensor, ...]
    """Poses (N, P, 4, 4) of both bodies there, and what else is kept (N, P, ...)."""

    def keep(self, error: Tensor, kept: tuple[Tensor, ...]) -> Tensor:
        """Keep the iterates that are better, and return their mask (N, P); an error that is NaN never is."""
        better = error < self.error
        self.error = torch.where(better, error, self.error)
        self.kept = _where(better, kept, self.kept)
        return better


def _where(mask: Tensor, chosen: tuple[Tensor, ...], others: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """Select among values (N, P, ...) by a mask (N, P) of tasks."""
    pairs = zip(chosen, others, strict=True)
    return tuple(torch.where(mask.reshape(*mask.shape, *[1] * (x.ndim - mask.ndim)), x, y) for x, y in pairs)


def _run_at(iteration: int, first: int) -> tuple[int, int, int]:
    """Return the run of an iteration, the position in it, and its length; the first one has its own."""
    later, position = divmod(iteration - first, RUN_ITERATIONS)
    return (later + 1, position, RUN_ITERATIONS) if later >= 0 else (0, iteration, first)


def _is_far(run: int) -> bool:
    """Return whether a run starts far from all others; those near the best pose lack the largest steps."""
    return run == 0 or run % 2 == 1


def _restarted(
    T: tuple[Tensor, ...], problem: _Problem, initial: np.ndarray, seed: int, run: int
) -> tuple[Tensor, Tensor]:
    """Return poses with body b turned about its target at random, which is put on the target of body a.

    Random numbers are those of a task, which its initial pose (N, P, 4, 4) of body b identifies.
    """
    T_a, T_b, target_a, target_b = (
        x.double().cpu().numpy().reshape(-1, *x.shape[2:]) for x in (*T, problem.target_a, problem.target_b)
    )
    flat = initial.reshape(-1, 4, 4)
    w = np.array([random_rotation(generator(seed, start, run), far=_is_far(run)) for start in flat])
    turned_b = turned(T_b, transform_points(T_b, target_b), w, transform_points(T_a, target_a))
    return T[0], torch.as_tensor(turned_b.reshape(initial.shape)).to(T[1])


def _unit_twists(T: tuple[Tensor, ...], gradients: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """Return body twists (v, w) (N, P, 6) of the gradients of moving bodies, scaled to length one; 0 stays 0."""
    found = []
    for pose, gradient in zip(T[-len(gradients) :], gradients, strict=True):
        twist = body_gradient(pose, gradient)
        length = twist.norm(dim=-1, keepdim=True)
        found.append(twist / torch.where(length > 0, length, torch.ones_like(length)))
    return tuple(found)


def _step(T: Tensor, unit: Tensor, size: Tensor) -> Tensor:
    """Return T exp(-(v s_t, w s_r)) for unit twists (v, w) (N, P, 6) and s_r = size (N, P, 1)."""
    scale = unit.new_tensor([METRES_PER_RADIAN] * 3 + [1.0] * 3)
    return retract(T, -unit * scale * size)
