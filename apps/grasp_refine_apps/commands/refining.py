"""Refining the grasps of one object at one scale, and proving them: what `run` and `batch` do with each group."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from grasp_refine.core.se3 import transform_from_pose
from grasp_refine.pipeline.problem import Group
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.solvers.least_squares import Progress
from grasp_refine.results.outcome import Outcome, compare
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.validation.motion import Motion, closing
from grasp_refine.validation.trials import Trials
from grasp_refine.validation.world import World


def refined(group: Group, config: Config, progress: Progress, prepared: HandObject) -> Outcome:
    """The grasps of a group before and after.

    Args:
        group: The grasps.
        config: How they are refined.
        progress: Called after each iteration.
        prepared: Of their hand and object.
    """
    scene = group.scene
    refinement = refine(scene, config, progress, prepared=prepared)
    after = replace(scene, T_world_root=refinement.T_world_root, q=refinement.q)
    return compare(
        scene,
        refinement,
        closing(after, prepared),
        margin=config.margin,
        name=group.object,
        scale=group.scale,
        row=group.rows,
        index=group.index,
    )


def proved(
    group: Group, outcome: Outcome, world: World, tell: Callable[[str, float], None], threads: int | None = None
) -> tuple[Trials, Trials]:
    """What simulation says of the grasps of a group before and after.

    Args:
        group: The grasps as they came.
        outcome: What became of them.
        world: Their hand and object.
        tell: Hears what is simulated, and how many grasps are done, in fractions.
        threads: CPU threads; by default as many as there are.
    """
    from grasp_refine.validation.simulation import simulate

    after = Motion(transform_from_pose(outcome.stage_pose), outcome.stage_q)
    return (
        simulate(world, group.motion(), threads=threads, progress=lambda done: tell("simulating, before", done)),
        simulate(world, after, threads=threads, progress=lambda done: tell("simulating, after", done)),
    )
