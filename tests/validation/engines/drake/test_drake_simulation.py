"""Grasps simulated in Drake against physics that is known in closed form, and against MuJoCo."""

import numpy as np
import pytest

from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.drake.contacts import CONTACT_STIFFNESS_N_M
from grasp_refine.validation.engines.drake.rows import engine_for
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import World, build_world
from gripper import KP, RADIUS, ball, gripper


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(gripper(), ball(), Task(DEXGRASPBENCH))


@pytest.mark.parametrize("soft", [1.0, 3.0])
def test_a_plate_sinks_in_by_its_force_over_the_stiffness_of_contacts(world: World, soft: float) -> None:
    """Stiffness falls with the square of the time constant."""
    conditions = Conditions(np.eye(4)[None], np.array([0.6]), contact_time=np.array([soft]))
    rows = engine_for(world)(world, conditions, np.array([True]), 1)
    origin = np.array([[0.0, 0, 0, 1, 0, 0, 0]])
    rows.place(origin - [0, 0, 0.1, 0, 0, 0, 0], np.array([[-RADIUS, RADIUS]]), origin)
    rows.drive(origin - [0, 0, 0.1, 0, 0, 0, 0], np.array([[-RADIUS + 0.01, RADIUS - 0.01]]))
    rows.step(300)
    depth = rows.touching(np.array([0])).depth[0]
    assert depth == pytest.approx(KP * (0.01 - depth) / (CONTACT_STIFFNESS_N_M / soft**2), rel=0.02)
