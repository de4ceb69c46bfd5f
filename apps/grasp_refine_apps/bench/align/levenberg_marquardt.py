"""Levenberg-Marquardt on alignment tasks: each task ends when it is solved, or when its budget is used up."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from grasp_refine.refinement.solvers.iterate import Point, minimise
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine_apps.bench.align.aligned import AlignmentResult, errors_at, pad_tasks
from grasp_refine_apps.bench.align.bodies import BodyPair
from grasp_refine_apps.bench.align.problem import AlignProblem
from grasp_refine_apps.bench.align.stopwatch import Stopwatch
from grasp_refine_apps.bench.align.tasks import Tasks
from grasp_refine_apps.bench.align.variants import Variant

TOLERANCE_M2 = 1e-14
"""Errors (m^2) below this, a tenth of a micrometre, end a task."""

STALL_ITERATIONS = 9
"""Iterations without progress before a restart."""
RADIUS_FACTORS = (1.0, 0.5, 2.0, 0.25, 0.0, np.inf)
"""Factors of the neighbourhoods' radii, one after the other at each rejection; the last treats faces as planes."""


def run_levenberg_marquardt(
    bodies: Sequence[BodyPair],
    tasks: Sequence[Tasks],
    variant: Variant,
    *,
    seed: int = 0,
    progress: Callable[[float], None] = lambda share: None,
) -> AlignmentResult:
    """Run the tasks of several pairs together; the result of a task does not depend on the others.

    The derivative is that of contact kinematics, and a stalled task restarts without limit.

    Args:
        bodies: P pairs.
        tasks: Tasks of each pair; some pairs may have more than others.
        variant: Margin, budget in iterations, each one witness query, and witness.
        seed: Seed of restarts.
        progress: Called from time to time with the share of the budget that is used.
    """
    budget = variant.budget
    assert budget is not None, "only descent has a time budget"
    watch = Stopwatch()
    problem = AlignProblem(bodies, tasks, variant.margin, seed, variant.solver_patch, watch)
    counts = np.array([len(its) for its in tasks])
    first = np.cumsum(counts) - counts
    start = Point(problem.tasks.T_world_b, np.zeros((counts.sum(), 0)))
    # Caches built at the first call are not part of the loop's time.
    problem.evaluate(first, Point(start.T[first], start.q[first]), None)
    most = budget * -(-counts.sum() // problem.width)

    def told(done: int, iteration: int, loss: float) -> None:
        if iteration % 10 == 0:
            progress(min(iteration / most, 1.0))

    settings = LevenbergMarquardt(
        iterations=budget,
        restarts=budget,
        patience=STALL_ITERATIONS,
        good=0.0,
        widths=RADIUS_FACTORS,
    )
    start_cpu, start_wall = time.process_time(), time.perf_counter()
    with watch:
        found = minimise(problem, start, settings, TOLERANCE_M2, progress=told)
    cpu_s, wall_s = time.process_time() - start_cpu, time.perf_counter() - start_wall
    task = np.arange(counts.max())[:, None]
    member = first + task % counts
    T_a, T_b = problem.tasks.T_world_a[member], found.point.T[member]
    error = errors_at(bodies, pad_tasks(tasks), T_a, T_b, variant.margin)
    iterations = np.where(task < counts, found.iterations[member], 0)
    return AlignmentResult(error, error, T_a, T_b, iterations, watch, cpu_s, wall_s)
