"""Closing of gaps: flat faces turn onto each other where they can, links touch; links that cannot are released."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from grasp_refine.core.array_records import choose, take
from grasp_refine.core.se3 import transform_points
from grasp_refine.refinement.grasp_problem import GraspProblem
from grasp_refine.refinement.solvers.iterate import IterationCallback, Minimum, Point, Progress, Solver, minimise
from grasp_refine.refinement.solvers.status import Status
from grasp_refine.refinement.terms.contact import contact_gap
from grasp_refine.scene.contact_selection import num_groups
from grasp_refine.scene.goal import Goal

RELEASE_GAP_M = 5e-4
"""Gap in metres, when nothing closes it any more, from which on a link need not touch."""


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


def release_targets(
    problem: GraspProblem, found: Minimum, solver: Solver, *, seconds: np.ndarray, progress: Progress | None = None
) -> tuple[Minimum, GraspProblem]:
    """Close the gaps of grasps that miss targets without these targets: the links touch where they can.

    Args:
        problem: Problem of N grasps.
        found: Its minima; some may have gaps or misses left.
        solver: Levenberg-Marquardt.
        seconds: CPU time left for each grasp (N,).
        progress: As for `minimise`.

    Returns:
        The minima, and the problem without the released targets.
    """
    goal, left = problem.goal, np.flatnonzero(np.isin(found.status, (Status.STALLED, Status.BUDGET)))
    T_link = problem.evaluate(left, take(found.point, left), None).T_link
    miss = np.linalg.norm(transform_points(T_link, goal.target_link[left]) - goal.target_object[left], axis=-1)
    missed = np.zeros_like(goal.touching)
    missed[left] = miss > RELEASE_GAP_M
    on_link, on_object = (np.where(missed[..., None], np.nan, each) for each in (goal.target_link, goal.target_object))
    goal = replace(goal, target_link=on_link, target_object=on_object)
    return _close_again(problem, found, goal, np.asarray(missed.any(axis=1)), solver, seconds, progress)


def release_links(
    problem: GraspProblem, found: Minimum, solver: Solver, *, seconds: np.ndarray, progress: Progress | None = None
) -> tuple[Minimum, GraspProblem]:
    """Close the gaps of grasps whose links cannot all touch, without the link that is farthest from touching.

    Links of two fingers, or of a finger and the palm, go on touching.

    Args:
        problem: Problem of N grasps.
        found: Its minima; some may have gaps left.
        solver: Levenberg-Marquardt.
        seconds: CPU time left for each grasp (N,).
        progress: As for `minimise`.

    Returns:
        The minima, and the problem without the released links.
    """
    goal, setup, scene = problem.goal, problem.setup, problem.scene
    left = np.flatnonzero(np.isin(found.status, (Status.STALLED, Status.BUDGET)) & (goal.touching.sum(axis=1) > 2))
    if not len(left):
        return found, problem
    witness = problem.evaluate(left, take(found.point, left), None).witness
    gap = np.abs(contact_gap(witness, setup.anywhere[left], setup.margin + setup.clearance))
    worst, at = gap.argmax(axis=1), np.arange(len(left))
    touching = goal.touching[left]
    touching[at, worst] = False
    freed = (gap[at, worst] > RELEASE_GAP_M) & (num_groups(scene.hand, scene.links, touching) >= 2)
    released = np.zeros(len(found.status), dtype=bool)
    released[left[freed]] = True
    all_touching = goal.touching.copy()
    all_touching[released] = touching[freed]
    return _close_again(problem, found, replace(goal, touching=all_touching), released, solver, seconds, progress)


def _close_again(
    problem: GraspProblem,
    found: Minimum,
    goal: Goal,
    rows: np.ndarray,
    solver: Solver,
    seconds: np.ndarray,
    progress: Progress | None,
) -> tuple[Minimum, GraspProblem]:
    """Return the minima, anew for the grasps in a mask (N,) with another goal, and the problem with that goal."""
    if not rows.any():
        return found, problem
    again = problem.with_goal(goal)
    status = np.where(rows, Status.RUNNING, found.status)
    more = close_gaps(
        again, found.point, solver, problem.config.tolerance, status=status, seconds=seconds, progress=progress
    )
    after = replace(
        found,
        point=choose(rows, more.point, found.point),
        loss=np.stack([found.loss[:, 0], np.where(rows, more.loss[:, 1], found.loss[:, 1])], axis=1),
        status=more.status,
        iterations=found.iterations + more.iterations,
        queries=found.queries + more.queries,
    )
    return after, again
