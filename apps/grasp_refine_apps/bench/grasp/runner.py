"""Runs of a variant on the tasks of a set, and measures of the results."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from grasp_refine.core.profiling import Stopwatch
from grasp_refine.measures.geometry import Movement, movement
from grasp_refine.refinement.refine import refine
from grasp_refine.scene.hand_object import HandObject
from grasp_refine_apps.bench.grasp.measures import Measures, measure_grasps
from grasp_refine_apps.bench.grasp.tasks import Tasks
from grasp_refine_apps.bench.grasp.together import run_together
from grasp_refine_apps.bench.grasp.variants import Kind, Variant
from grasp_refine_apps.bench.jobs import Job, Progress, part_of
from grasp_refine_apps.bench.timing import one_thread, warmed_up


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
class SetResult:
    """Results of one variant on tasks of one kind of one set."""

    task: SetTask
    parts: tuple[GroupResult, ...]
    span: tuple[float, float] | None = None
    """Wall-clock times in seconds at which the first call began and the last one ended."""


@dataclass(frozen=True, eq=False)
class SetTask:
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
    def job(self) -> Job:
        """The job, which takes as long as its grasps have iterations; Levenberg-Marquardt seldom needs all."""
        most = self.variant.iterations
        work = float(sum(map(len, self.tasks)) * (min(most, 30) if self.variant.least_squares else most))
        return Job(f"{self.set}, {self.variant.solver}, {self.variant.what}", self.do, work)

    def do(self, progress: Progress) -> SetResult:
        """Refine and measure all tasks, in this process or in as many as the variant has."""
        many = self.variant.processes
        if many is None:
            return self.run(lambda: None, progress)
        shares = [[group.take(slice(start, None, many)) for group in self.tasks] for start in range(many)]
        tasks = [replace(self, tasks=tuple(group for group in share if len(group))) for share in shares]
        found = run_together([task.run for task in tasks])
        begins, ends = zip(*(one.span for one in found if one.span is not None), strict=True)
        return SetResult(self, tuple(part for one in found for part in one.parts), (min(begins), max(ends)))

    def run(self, ready: Callable[[], None], progress: Progress = lambda share: None) -> SetResult:
        """Refine and measure all tasks in this process; `ready` is called before the first measurement."""
        torch.set_num_threads(self.threads)
        with one_thread():
            # Caches built once for a hand and an object are not timed.
            config = self.variant.config(self.seed, self.tolerance)
            prepared = [warmed_up(tasks.scene, [config]) for tasks in self.tasks]
            ready()
            begin, total, finished, parts = time.perf_counter(), sum(map(len, self.tasks)), 0, []
            for tasks, hand_object in zip(self.tasks, prepared, strict=True):
                parts.append(self._refined(tasks, hand_object, part_of(progress, finished / total, 1.0 / total)))
                finished += len(tasks)
            span = begin, time.perf_counter()
            return SetResult(self, tuple(part() for part in parts), span)

    def _refined(
        self, tasks: Tasks, prepared: HandObject, progress: Callable[[float], None]
    ) -> Callable[[], GroupResult]:
        """Refine tasks, and return the function that measures the results, which is not timed."""
        scene, config = tasks.scene, self.variant.config(self.seed, self.tolerance)
        watch, found, times = Stopwatch(), [], []
        for start, stop in calls(len(tasks), self.variant):
            some = tasks.take(slice(start, stop)).scene

            def report(done: int, iteration: int, loss: float, before: int = start) -> None:
                progress(before + done)

            wall, cpu = time.perf_counter(), time.process_time()
            with watch:
                found.append(refine(some, config, report, prepared=prepared))
            cost = np.array([time.process_time() - cpu, time.perf_counter() - wall]) / (stop - start)
            times.append(np.repeat(cost[:, None], stop - start, axis=1))
        cpu_s, wall_s = np.concatenate(times, axis=1)

        def measured() -> GroupResult:
            T, q, touching, status, iterations, queries, solver_cpu_s = (
                np.concatenate([getattr(one, name) for one in found])
                for name in ("T_world_root", "q", "touching", "status", "iterations", "queries", "cpu_s")
            )
            before, after = measure_grasps(scene, scene.T_world_root, scene.q), measure_grasps(scene, T, q)
            moved = movement(scene.T_world_root, scene.q, T, q, scene.hand.slides)
            counts = touching, status, iterations, queries
            return GroupResult(tasks, before, after, moved, *counts, cpu_s, wall_s, solver_cpu_s, watch)

        return measured


def calls(count: int, variant: Variant) -> list[tuple[int, int]]:
    """Return first and last tasks of each call of `refine`: Levenberg-Marquardt keeps its batch full, others cannot."""
    size = count if variant.least_squares and variant.batch > 1 else variant.batch
    return [(start, min(start + size, count)) for start in range(0, count, size)]
