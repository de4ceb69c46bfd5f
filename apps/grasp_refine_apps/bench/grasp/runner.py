"""Runs of a variant on the tasks of a set, and measures of the results."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import torch

from grasp_refine.core.profiling import Stopwatch
from grasp_refine.refinement.refine import Refinement, refine
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.validation.geometry import Movement, movement
from grasp_refine_apps.bench.grasp.measures import Measures, measure_grasps
from grasp_refine_apps.bench.grasp.sets import GraspSet
from grasp_refine_apps.bench.grasp.tasks import Kind, Tasks
from grasp_refine_apps.bench.grasp.together import run_together
from grasp_refine_apps.bench.grasp.variants import Variant
from grasp_refine_apps.bench.timing import one_thread

WARM_UP_ITERATIONS = 2
"""Iterations, and number of grasps, of the run before the first measurement."""


@dataclass(frozen=True, eq=False)
class GroupResult:
    """Results of N tasks on one object."""

    tasks: Tasks
    before: Measures
    after: Measures
    moved: Movement
    touching: np.ndarray
    """Links (N, L) that should touch."""
    status: np.ndarray
    """A `Status` for each task (N,)."""
    iterations: np.ndarray
    queries: np.ndarray
    """Narrow-phase queries of the solver (N,)."""
    cpu_s: np.ndarray
    """CPU seconds (N,) of each task's call, shared evenly by the grasps in it."""
    wall_s: np.ndarray
    """Wall seconds (N,) of each task's call, shared evenly by the grasps in it."""
    solver_cpu_s: np.ndarray
    """CPU seconds (N,) of the solver's loop, as counted by the solver itself."""
    watch: Stopwatch = field(default_factory=Stopwatch)
    """CPU time of all calls by stage."""


@dataclass(frozen=True, eq=False)
class JobResult:
    """Results of a job."""

    job: SetJob
    parts: tuple[GroupResult, ...]
    span: tuple[float, float] | None = None
    """Wall-clock times in seconds at which the first call began and the last one ended."""


@dataclass(frozen=True, eq=False)
class SetJob:
    """One variant on tasks of one kind of one set."""

    variant: Variant
    set: str
    """Name of the set."""
    hand: str
    """Name of the hand."""
    kind: Kind
    """Tasks with or without targets."""
    tasks: tuple[Tasks, ...]
    """Tasks by object and scale."""
    seed: int
    tolerance: float
    threads: int

    @property
    def work(self) -> float:
        """Approximate duration: grasps times iterations, of which Levenberg-Marquardt seldom needs all."""
        most = self.variant.iterations
        return float(sum(map(len, self.tasks)) * (min(most, 30) if self.variant.least_squares else most))

    @property
    def label(self) -> str:
        """Label of the job, for a progress bar."""
        return f"{self.set}, {self.variant.solver}, {self.variant.what}"

    def do(self, progress: Callable[[float], None]) -> JobResult:
        """Refine and measure all tasks, in this process or in as many as the variant has."""
        many = self.variant.processes
        if many is None:
            return self.run(lambda: None, progress)
        shares = [[its.take(slice(start, None, many)) for its in self.tasks] for start in range(many)]
        jobs = [replace(self, tasks=tuple(its for its in share if len(its))) for share in shares]
        found = run_together([job.run for job in jobs])
        begins, ends = zip(*(done.span for done in found), strict=True)
        return JobResult(self, tuple(part for done in found for part in done.parts), (min(begins), max(ends)))

    def run(self, ready: Callable[[], None], progress: Callable[[float], None] = lambda share: None) -> JobResult:
        """Refine and measure all tasks in this process; `ready` is called before the first measurement."""
        torch.set_num_threads(self.threads)
        with one_thread():
            return self._run(ready, progress)

    def _run(self, ready: Callable[[], None], progress: Callable[[float], None]) -> JobResult:
        # Caches built once for a hand and an object are not timed.
        prepared = [self._prepared(tasks) for tasks in self.tasks]
        total, finished, timed = sum(map(len, self.tasks)), 0, []
        ready()
        begin = time.perf_counter()
        for tasks, its in zip(self.tasks, prepared, strict=True):
            before = finished

            def within(done: int, before: int = before) -> None:
                progress((before + done) / total)

            timed.append(self._timed(tasks, its, within))
            finished += len(tasks)
        span = begin, time.perf_counter()
        return JobResult(self, tuple(map(_measured, self.tasks, timed)), span)

    def _prepared(self, tasks: Tasks) -> HandObject:
        """Prepare hand and object, warmed up."""
        prepared, config = HandObject.of(tasks.scene), self.variant.config(self.seed, self.tolerance)
        short = replace(config, solver=replace(config.solver, iterations=WARM_UP_ITERATIONS))
        refine(tasks.take(slice(WARM_UP_ITERATIONS)).scene, short, prepared=prepared)
        return prepared

    def _timed(self, tasks: Tasks, prepared: HandObject, progress: Callable[[int], None]) -> _Timed:
        config = self.variant.config(self.seed, self.tolerance)
        watch, found, cpu, wall = Stopwatch(), [], [], []
        for start, stop in calls(len(tasks), self.variant):
            scene = tasks.take(slice(start, stop)).scene
            clock, own = time.perf_counter(), time.process_time()
            told = partial(_report, progress, start)
            with watch:
                found.append(refine(scene, config, told, prepared=prepared))
            share = 1.0 / (stop - start)
            cpu += [(time.process_time() - own) * share] * (stop - start)
            wall += [(time.perf_counter() - clock) * share] * (stop - start)
        return _Timed(found, np.array(cpu), np.array(wall), watch)


@dataclass(frozen=True, eq=False)
class _Timed:
    """Refined tasks with the times of each call."""

    found: list[Refinement]
    cpu_s: np.ndarray
    wall_s: np.ndarray
    watch: Stopwatch


def _measured(tasks: Tasks, timed: _Timed) -> GroupResult:
    scene = tasks.scene
    T, q, touching, status, iterations, queries, solver_cpu_s = (
        np.concatenate([getattr(one, name) for one in timed.found])
        for name in ("T_world_root", "q", "touching", "status", "iterations", "queries", "cpu_s")
    )
    return GroupResult(
        tasks=tasks,
        before=measure_grasps(scene, scene.T_world_root, scene.q),
        after=measure_grasps(scene, T, q),
        moved=movement(scene.T_world_root, scene.q, T, q),
        touching=touching,
        status=status,
        iterations=iterations,
        queries=queries,
        cpu_s=timed.cpu_s,
        wall_s=timed.wall_s,
        solver_cpu_s=solver_cpu_s,
        watch=timed.watch,
    )


def _report(progress: Callable[[int], None], before: int, done: int, iteration: int, loss: float) -> None:
    progress(before + done)


def calls(count: int, variant: Variant) -> list[tuple[int, int]]:
    """Return first and last tasks of each call of `refine`: Levenberg-Marquardt keeps its batch full, others cannot."""
    size = count if variant.least_squares and variant.batch > 1 else variant.batch
    return [(start, min(start + size, count)) for start in range(0, count, size)]


def jobs(
    variants: Sequence[Variant],
    sets: Sequence[tuple[GraspSet, Kind, tuple[Tasks, ...]]],
    *,
    singles: int,
    seed: int,
    tolerance: float,
    threads: int,
) -> list[SetJob]:
    """Make one job for each set, kind of tasks and variant.

    Args:
        variants: Variants to compare.
        sets: Sets with a kind of tasks and these tasks, by object and scale.
        singles: Largest number of tasks of a set that are run one at a time.
        seed: Seed of the solvers.
        tolerance: Loss in m^2 below which a grasp is solved.
        threads: Threads of torch.
    """
    made = []
    for grasp_set, kind, tasks in sets:
        for variant in variants:
            chosen = tuple(found for its in tasks if (found := its.of(variant)) is not None)
            if not chosen:
                continue
            if variant.batch == 1:
                # Evenly from all objects.
                each, more = divmod(singles, len(chosen))
                chosen = tuple(its.take(slice(each + (i < more))) for i, its in enumerate(chosen[:singles]))
            made.append(SetJob(variant, grasp_set.name, grasp_set.hand, kind, chosen, seed, tolerance, threads))
    return made
