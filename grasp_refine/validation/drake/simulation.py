"""Simulation of grasps in Drake, by the same protocol, motion and limits as in MuJoCo."""

from __future__ import annotations

from collections.abc import Callable

from grasp_refine.core.arguments import check_kind
from grasp_refine.validation import simulation
from grasp_refine.validation.drake.rows import Plants
from grasp_refine.validation.motion import Motion
from grasp_refine.validation.stepping import Conditions
from grasp_refine.validation.trials import Trials
from grasp_refine.validation.world import World


def simulate(
    world: World,
    motion: Motion,
    conditions: Conditions | None = None,
    *,
    threads: int | None = None,
    first_failure: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Trials:
    """Simulate N grasps; arguments as of MuJoCo's `simulate`, whose trial this is.

    Raises:
        GraspRefineError: as MuJoCo's does; or the hand has a part that Drake has no counterpart of; or a condition that
            only MuJoCo knows.
    """
    check_kind("world", world, World)
    return simulation.simulate(
        world,
        motion,
        conditions,
        threads=threads,
        first_failure=first_failure,
        progress=progress,
        engine=Plants(world).simulations,
    )
