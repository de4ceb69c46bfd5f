"""Trajectories of refined grasps, from approach to lift: planned, and followed in simulation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from grasp_refine.core.arguments import check_kind
from grasp_refine.core.array_records import join as rows_of_all
from grasp_refine.core.array_records import take
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.motion.plan import TrajectoryOptions, plan_motions
from grasp_refine.motion.trajectory_files import PlannedTrajectories, join
from grasp_refine.problem.input_cache import InputCache
from grasp_refine.problem.refined import RefinedGrasps
from grasp_refine.problem.worlds import worlds_of
from grasp_refine.scene.protocols.scene import SCENE
from grasp_refine.scene.task import Task


def plan_trajectories(refined: RefinedGrasps, options: TrajectoryOptions | None = None) -> PlannedTrajectories:
    """Return the trajectory of each refined grasp, from the approach to the lift, checked for collisions.

    Args:
        refined: Result of `refine`.
        options: Lengths of approach and lift; the defaults when None.
    """
    problem, parts = refined.problem, []
    for group in problem.groups:
        part, scene = refined.outcome.select(group.place), group.scene
        planned = plan_motions(part.posed(scene), part.motion, options)
        around = ((scene, group.scale),) * len(planned)
        parts.append(PlannedTrajectories(problem.hand, part.object, part.row, part.index, planned, around))
    return join(parts, problem.order)


def follow_trajectories(
    refined: RefinedGrasps,
    planned: PlannedTrajectories,
    task: Task | str | Path | None = None,
    *,
    cache: InputCache | None = None,
    threads: int | None = None,
) -> PlannedTrajectories:
    """Return planned trajectories with the results of MuJoCo following the free ones.

    Args:
        refined: Result of `refine`.
        planned: Its trajectories, of `plan_trajectories`.
        task: Another task, as of `load_task`, which counts where it names something; it lifts. None: the task of the
            refinement, by protocol `scene` where its own pushes.
        cache: Keeps models and worlds.
        threads: CPU threads; by default as many as there are.

    Raises:
        GraspRefineError: an argument of another type, trajectories of other grasps, a protocol that pushes, or MuJoCo
            cannot compile the hand or the world.
    """
    from grasp_refine.motion.execution import follow

    check_kind("refined", refined, RefinedGrasps)
    check_kind("planned", planned, PlannedTrajectories)
    problem = refined.problem.for_task(task)
    if task is None and not problem.task.test(patches=problem.hand.patches).tabletop:
        problem = problem.for_task(Task(SCENE))
    if len(planned) != len(problem):
        raise GraspRefineError(f"there are {len(planned)} trajectories, and {len(problem)} grasps")
    if planned.hand.joint_names != problem.hand.joint_names:
        raise GraspRefineError(
            f"the trajectories are of hand '{planned.hand.name}', the grasps of '{problem.hand.name}'"
        )
    parts = []
    for group, world in zip(problem.groups, worlds_of(problem, cache=cache), strict=True):
        plans = [planned.plans[place] for place in group.place.tolist()]
        parts.append(follow(world, problem.hand, plans, threads=threads))
    return replace(planned, executions=take(rows_of_all(*parts), problem.order))
