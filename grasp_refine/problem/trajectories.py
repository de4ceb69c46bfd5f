"""Trajectories of refined grasps, from approach to lift: planned, and followed in simulation."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from grasp_refine.core.arguments import check_kind
from grasp_refine.core.array_records import join as rows_of_all
from grasp_refine.core.array_records import take
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.motion.plan import TrajectoryOptions, plan_motions
from grasp_refine.motion.trajectory_files import PlannedTrajectories, join
from grasp_refine.problem.input_cache import InputCache, NoCache
from grasp_refine.problem.refined import RefinedGrasps
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.protocol_file import load_protocol
from grasp_refine.scene.protocols.scene import SCENE


def plan_trajectories(
    refined: RefinedGrasps, options: TrajectoryOptions | None = None, *, cache: InputCache | None = None
) -> PlannedTrajectories:
    """Return the trajectory of each refined grasp, from the approach to the lift, checked for collisions.

    Args:
        refined: Result of `refine`.
        options: Lengths of approach and lift; the defaults when None.
        cache: Keeps prepared hands and objects.
    """
    problem, cache = refined.problem, cache or NoCache()
    parts = []
    for group in problem.groups:
        part, scene = refined.outcome.select(group.place), group.scene
        prepared = cache.get("prepared", (problem.hand, scene.object), partial(HandObject.of, scene))
        planned = plan_motions(part.posed(scene), part.motion, options, prepared)
        around = ((scene, group.scale),) * len(planned)
        parts.append(PlannedTrajectories(problem.hand, part.object, part.row, part.index, planned, around))
    return join(parts, problem.order)


def follow_trajectories(
    refined: RefinedGrasps,
    planned: PlannedTrajectories,
    protocol: str | Path | Protocol = SCENE,
    *,
    cache: InputCache | None = None,
    threads: int | None = None,
) -> PlannedTrajectories:
    """Return planned trajectories with the results of MuJoCo following the free ones.

    Args:
        refined: Result of `refine`.
        planned: Its trajectories, of `plan_trajectories`.
        protocol: One that lifts, or its name or file: friction, masses and time step of the simulation, and when an
            object is lost.
        cache: Keeps models and worlds.
        threads: CPU threads; by default as many as there are.

    Raises:
        GraspRefineError: an argument of another type, trajectories of other grasps, a protocol that pushes, or MuJoCo
            cannot compile the hand or the world.
    """
    from grasp_refine.motion.execution import follow
    from grasp_refine.validation.engines.mujoco.world import build_world
    from grasp_refine.validation.validate import model_of

    check_kind("refined", refined, RefinedGrasps)
    check_kind("planned", planned, PlannedTrajectories)
    protocol = protocol if isinstance(protocol, Protocol) else load_protocol(str(protocol))
    problem, cache = refined.problem, cache or NoCache()
    if len(planned) != len(problem):
        raise GraspRefineError(f"there are {len(planned)} trajectories, and {len(problem)} grasps")
    if planned.hand.joint_names != problem.hand.joint_names:
        raise GraspRefineError(
            f"the trajectories are of hand '{planned.hand.name}', the grasps of '{problem.hand.name}'"
        )
    model = cache.get("model", problem.hand, partial(model_of, problem.hand))
    parts = []
    for group in problem.groups:
        surroundings = group.scene.object, protocol, group.scene.table, group.scene.environment
        world = cache.get("world", (problem.hand, *surroundings), partial(build_world, model, *surroundings))
        plans = [planned.plans[place] for place in group.place.tolist()]
        parts.append(follow(world, problem.hand, plans, threads=threads))
    return replace(planned, executions=take(rows_of_all(*parts), problem.order))
