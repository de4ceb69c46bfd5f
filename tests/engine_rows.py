"""Simulations in another engine beside MuJoCo's, and what is in them."""

from __future__ import annotations

from typing import Any

import numpy as np

from grasp_refine.core.se3 import exp_so3, transform, transform_from_pose
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.task import Task
from grasp_refine.validation.engine_table import engine_of
from grasp_refine.validation.engines.mujoco.hand_model import HandModel
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.stepping import Rows as MujocoRows
from grasp_refine.validation.engines.mujoco.world import World, build_world
from gripper import ball

ORIGIN = np.array([[0.0, 0, 0, 1, 0, 0, 0]])
ROOT_JOINTS = 6
"""Joints of the root in PhysX: three slides and three hinges."""


def both(engine: str, world: World, conditions: Conditions) -> tuple[Any, MujocoRows]:
    """Simulations in an engine and in MuJoCo."""
    running = np.ones(len(conditions.friction), dtype=bool)
    return engine_of(engine, world)(world, conditions, running, 1), MujocoRows(world, conditions, running, 1)


def joints(rows: Any) -> np.ndarray:
    """Values (N, m) of the joints of a hand in Drake or PhysX."""
    state = rows.state()
    if hasattr(rows, "_plant"):
        return state[:, -rows._moving.shape[1] :][:, rows._plant.joints]
    count = rows._joint_count
    return state[:, 7 + count : 7 + 2 * count][:, rows._blueprints[0].joints]


def driven(engine: str, hand: HandModel, *aim: float, steps: int = 400) -> np.ndarray:
    """Values of the joints of a hand after some time at set points."""
    world = build_world(hand, ball(), Task(DEXGRASPBENCH))
    rows, _ = both(engine, world, Conditions.nominal(world, 1))
    rows.place(ORIGIN, world.model.qpos0[world.joints_at][None], ORIGIN + [0, 0, -1, 0, 0, 0, 0])
    rows.drive(ORIGIN, np.array([aim]))
    rows.step(steps)
    return joints(rows)[0]


def palm(rows: Any) -> np.ndarray:
    """Pose (4, 4) of the palm in the first simulation in Drake or PhysX."""
    if hasattr(rows, "_plant"):
        with rows._spaces[0].borrow() as space:
            space.load(rows._start[0], rows._set_points[0], rows._moving[0], rows._wrench[0])
            return rows._plant.plant.GetBodyByName("hand/palm").EvalPoseInWorld(space._context).GetAsMatrix4()
    values = rows._moving[0, :ROOT_JOINTS]
    R = np.eye(3)
    for axis, value in zip(np.eye(3), values[3:], strict=True):
        R = R @ exp_so3(value * axis)
    return transform_from_pose(rows._start)[0] @ transform(R, values[:3])


def root_errors(rows: Any) -> np.ndarray:
    """Distances (N, 6) of the joints of the root from their set points in Drake or PhysX: metres, then radians."""
    if hasattr(rows, "_plant"):
        return np.abs(rows._moving[:, rows._plant.root] - rows._set_points[:, rows._plant.root_servos])
    return np.abs(rows._moving[:, :ROOT_JOINTS] - rows._targets[:, :ROOT_JOINTS])
