"""Schedule of a task: when the hand is sent where, and what the object must bear."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.export.exported import ExportedGrasps
from grasp_refine.scene.protocols.protocol import AXES, Protocol
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.simulation import Course
from grasp_refine.validation.validate import model_of

ENDS = {"pregrasp": (0, 0.0), "grasp": (0, 1.0), "squeeze": (1, 1.0)}
"""Name of a stage -> its place on a `Course`: the stage before, and the share of the way to the next one."""


def simulated(grasps: ExportedGrasps) -> tuple[World, Course]:
    """Return the world in which the task of grasps is simulated, and the course of the hand in it."""
    world = build_world(model_of(grasps.hand), grasps.object, grasps.scene.task.for_simulation)
    motion = grasps.motion
    return world, Course.of(world, motion.T_world_root, motion.q, motion.finite)


def closing_rows(protocol: Protocol) -> list[tuple[int, float]]:
    """Return the stage, and the share of the way to the next one, of each set point from pregrasp to squeeze."""
    return [(stage, (move + 1) / protocol.moves) for stage in (0, 1) for move in range(protocol.moves)]


def lift_heights(protocol: Protocol) -> Float[np.ndarray, " L"]:
    """Return the heights (L,) in metres that the hand is raised to, one after the other; none without a lift."""
    if not protocol.tabletop:
        return np.zeros(0)
    parts = max(protocol.steps_per_check // protocol.steps_per_move, 1)
    return protocol.lift * np.arange(1, protocol.checks * parts + 1) / (protocol.checks * parts)


def limits_of(world: World) -> dict[str, np.ndarray]:
    """Return pushes, steps and limits of the task, as `mjcf` describes them."""
    protocol = world.protocol
    push = world.mass * protocol.acceleration * np.array([AXES[name] for name in protocol.directions]).reshape(-1, 3)
    numbers = {
        "steps": protocol.steps_per_move,
        "push_steps": protocol.steps_per_check,
        "checks": protocol.checks,
        "farthest": protocol.farthest,
        "steepest": protocol.steepest,
        "deepest": protocol.deepest,
        "lift_height": protocol.lift if protocol.tabletop else 0.0,
        "required": protocol.required(max(len(push), 1)),
    }
    return {"push": push, "up": world.up, **{name: np.asarray(value) for name, value in numbers.items()}}
