"""Closing of gaps: flat faces turn onto each other where the hand can do so, and links touch in any case."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from grasp_refine.core.array_records import choose
from grasp_refine.refinement.grasp_problem import GraspProblem
from grasp_refine.refinement.solvers.iterate import IterationCallback, Minimum, Point, Progress, Solver, minimise
from grasp_refine.refinement.solvers.status import Status


def close_gaps(
    problem: GraspProblem,
    start: Point,
    solver: Solver,
    tolerance: float,
    *,
    status: np.ndarray,
    seconds: float | np.ndarray,
    progress: Progress | None = None,
    on_iteration: IterationCallback | None = None,
) -> Minimum:
    """Minimise losses without forces; where faces cannot lie flat on each other, they touch in points in the end.

    No grasp of parallel jaws brings both onto faces that are not parallel. The sum of squares is least between lying
    flat and touching. From there contacts close in points, which moves the hand as little as the damping lets it: faces
    lie as flat as they can.

    Args:
        problem: Problem of N grasps.
        start: As for `minimise`, like all others.
        solver: Levenberg-Marquardt.
        tolerance: As there.
        status: As there.
        seconds: As there.
        progress: As there.
        on_iteration: As there.

    Returns:
        Minima, whose last losses are without gaps at corners where these could not be closed.
    """
    found = minimise(
        problem, start, solver, tolerance, status=status, seconds=seconds, progress=progress, on_iteration=on_iteration
    )
    left = problem.patched & np.isin(found.status, (Status.STALLED, Status.BUDGET))
    if not left.any():
        return found
    points = minimise(
        problem.in_points(),
        found.point,
        solver,
        tolerance,
        status=np.where(left, Status.RUNNING, found.status),
        seconds=seconds - found.cpu_s,
        progress=progress,
        on_iteration=on_iteration,
    )
    return replace(
        found,
        point=choose(left, points.point, found.point),
        loss=np.stack([found.loss[:, 0], np.where(left, points.loss[:, 1], found.loss[:, 1])], axis=1),
        status=points.status,
        iterations=found.iterations + points.iterations,
        queries=found.queries + points.queries,
        cpu_s=found.cpu_s + points.cpu_s,
        wall_s=found.wall_s + points.wall_s,
    )
