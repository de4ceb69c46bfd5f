"""The whole way of refined grasps: approach, pregrasp, grasp, squeeze and lift."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.motion.way import WayOptions, ways
from grasp_refine.motion.way_files import PlannedWays, join
from grasp_refine.pipeline.input_cache import InputCache, NoCache
from grasp_refine.pipeline.refined import RefinedGrasps
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.validation.motion import Motion


def plan_ways(
    refined: RefinedGrasps, options: WayOptions | None = None, *, cache: InputCache | None = None
) -> PlannedWays:
    """Return the way of each refined grasp, from the approach to the lift, checked for what is in the way.

    Args:
        refined: Result of `refine`.
        options: Lengths of approach and lift; the defaults when None.
        cache: Keeps prepared hands and objects.
    """
    problem, cache = refined.problem, cache or NoCache()
    parts = []
    for group in problem.groups:
        part, scene = refined.outcome.select(group.place), group.scene
        after = replace(scene, T_world_root=transform_from_pose(part.hand_pose), q=part.q)
        motion = Motion(transform_from_pose(part.stage_pose), part.stage_q)
        prepared = cache.get("prepared", (problem.hand, scene.object), partial(HandObject.of, scene))
        parts.append(PlannedWays(problem.hand, part.object, part.row, ways(after, motion, options, prepared)))
    return join(parts, problem.order)
