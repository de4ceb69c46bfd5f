"""Parameters of a world that may differ between grasps, for engines that build their own model of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import TypeVar

import numpy as np

from grasp_refine.core.array_types import Bool
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.engines.mujoco.stepping import Conditions, StepCallback
from grasp_refine.validation.engines.mujoco.world import World
from grasp_refine.validation.engines.simulations import Engine, Simulations

MAX_MODELS = 64
"""Largest number of models of a world that are kept: a chunk of grasps under different conditions."""

Model = TypeVar("Model")


@dataclass(frozen=True)
class Parameters:
    """Parameters of a model that may differ between grasps."""

    friction: float
    """Sliding friction of all contacts."""
    mass: float
    """Mass of the object, kg; its inertia is in proportion."""
    gain: float = 1.0
    """Factor of the stiffness of all servos."""
    force_limit: float = 1.0
    """Factor of the force limits of all servos."""
    contact_time: float = 1.0
    """Factor of the time constant of contacts: their stiffness is divided by its square."""

    @staticmethod
    def of(world: World) -> Parameters:
        """Return the parameters of a world."""
        return Parameters(world.protocol.friction, world.mass)


def parameters_of(
    world: World, conditions: Conditions, running: Bool[np.ndarray, " N"], *, engine: str
) -> list[Parameters]:
    """Return the parameters of N grasps; those of the world where conditions leave them open, or nothing runs.

    Raises:
        GraspRefineError: a condition that only MuJoCo knows; names `engine`.
    """
    if conditions.default_contact is not None and conditions.default_contact.any():
        raise GraspRefineError(f"MuJoCo's default contact is a condition of engine mujoco, not of {engine}")
    nominal = Parameters.of(world)
    given = {field.name: getattr(conditions, field.name) for field in fields(Parameters)}
    values = {name: value for name, value in given.items() if value is not None}
    return [
        replace(nominal, **{name: float(value[row]) for name, value in values.items()}) if runs else nominal
        for row, runs in enumerate(running)
    ]


def building_engine(
    world: World,
    build: Callable[[World, Parameters], Model],
    simulations: Callable[[World, list[Model], np.ndarray, int], Simulations],
    *,
    engine: str,
) -> Engine:
    """Return an engine that builds its models of a world as grasps under their conditions come, the protocol's at once.

    Args:
        world: The world.
        build: Builds a model.
        simulations: Begins simulations: called with world, model of each, (N,) True for running ones, and threads.
        engine: Name of the engine.

    Raises:
        GraspRefineError: the world has a part that the engine has no counterpart of; or, when it is called, a condition
            that only MuJoCo knows.
    """
    model_of = lru_cache(maxsize=MAX_MODELS)(lambda parameters: build(world, parameters))
    model_of(Parameters.of(world))

    def begin(
        world: World,
        conditions: Conditions,
        running: Bool[np.ndarray, " N"],
        threads: int,
        on_step: StepCallback | None = None,
    ) -> Simulations:
        chosen = parameters_of(world, conditions, running, engine=engine)
        return simulations(world, [model_of(parameters) for parameters in chosen], running, threads)

    return begin
