"""Engines that simulate grasps, by name."""

from __future__ import annotations

from importlib import import_module
from typing import Any, Literal, get_args

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.engines.mujoco.stepping import Rows
from grasp_refine.validation.engines.mujoco.world import World
from grasp_refine.validation.engines.simulations import Engine

EngineName = Literal["mujoco", "drake"]
"""Names of the engines."""

EngineChoice = Literal["mujoco", "drake", "both"]
"""An engine, or both, one after the other."""


def engine_of(name: str, world: World) -> Engine:
    """Return an engine for simulations of a world.

    Raises:
        GraspRefineError: there is no such engine, its package is not installed, or it has no scenes or arms.
    """
    plants = check_engine(name)
    if plants is not None and world.scene:
        raise GraspRefineError(
            f"engine {name} does not simulate scenes, as '{world.scene}': use mujoco, or `scene='none'`"
        )
    if plants is not None and world.hand.on_arm is not None:
        raise GraspRefineError("drake simulates hands without an arm: `engine='mujoco'` has hands on arms, too")
    return Rows if plants is None else plants(world).simulations


def check_engine(name: str) -> Any:
    """Return what simulates in an engine, given a world; None for MuJoCo.

    Raises:
        GraspRefineError: there is no such engine, or its package is not installed.
    """
    if name == "mujoco":
        return None
    if name != "drake":
        raise GraspRefineError(f"engine is {' or '.join(get_args(EngineName))}, got {name!r}")
    try:
        # An engine is a plug-in: it knows worlds and trials, which do not know it.
        return import_module("grasp_refine.validation.engines.drake.rows").Plants
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "pydrake":
            raise
        raise GraspRefineError("engine drake needs Drake: pip install 'grasp-refine[drake]'") from None
