"""Worlds of a problem: one for each object, in which its task is simulated."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from grasp_refine.problem.input_cache import InputCache, NoCache
from grasp_refine.problem.problem import Problem

if TYPE_CHECKING:
    from grasp_refine.hands.hand import Hand
    from grasp_refine.scene.task import Task
    from grasp_refine.validation.engines.mujoco.world import World

MAX_MASS_KG = 20.0
"""Mass of an object in kg from which on its unit is in doubt."""


def worlds_of(
    problem: Problem, *, cache: InputCache | None = None, on_note: Callable[[str], None] = lambda line: None
) -> list[World]:
    """Return the world of each group of a problem, with its hand, its object and its task.

    Args:
        problem: Hand, objects and task.
        cache: Keeps models and worlds for the next problem.
        on_note: Called with notes for the user on the model of the hand, scanned objects, and what is not simulated.

    Raises:
        GraspRefineError: MuJoCo cannot compile the hand or a world.
    """
    from grasp_refine.validation.engines.mujoco.world import build_world
    from grasp_refine.validation.validate import model_of

    hand, cache = problem.hand, cache or NoCache()
    model = cache.get("model", hand, partial(model_of, hand))
    for note in model.notes:
        on_note(note)
    for name in sorted({group.object for group in problem.groups if len(group.scene.object.hypotheses) > 1}):
        on_note(f"{name}: simulated as the first solid that it may be, whose quality validations show")
    for note in dict.fromkeys(_left_out(group.scene.task, hand) for group in problem.groups):
        if note:
            on_note(note)
    worlds = []
    for scene in (group.scene for group in problem.groups):
        setting = scene.object, scene.task.for_simulation
        worlds.append(cache.get("world", (hand, *setting), partial(build_world, model, *setting)))
    heavy = {group.object: world.mass for group, world in zip(problem.groups, worlds, strict=True)}
    for name, mass in heavy.items():
        if mass > MAX_MASS_KG:
            on_note(f"{name} weighs {mass:.3g} kg, which is a lot for a hand: masses are in kilograms")
    return worlds


def _left_out(task: Task, hand: Hand) -> str:
    """Return a note on surroundings of a task that its simulation does not have; "" if there are none."""
    protocol = task.test(patches=hand.patches)
    if protocol.tabletop or (task.plane is None and task.environment is None):
        return ""
    around = "table" if task.environment is None else f"scene '{task.environment.name}'"
    return f"{protocol.name} pushes in empty space: the {around} is not simulated"
