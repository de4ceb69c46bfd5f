"""Grasps simulated in PhysX against physics that is known in closed form."""

from math import radians

import numpy as np
import pytest

from grasp_refine.core.se3 import exp_so3, pose_from_transform, transform
from grasp_refine.objects.object import load_object
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.engines.physx.rows import Rows, engine_for
from gripper import gripper

FAR_HAND = np.array([[0.0, 5, 0, 1, 0, 0, 0]])


def rows_of(world: World) -> Rows:
    """Return one simulation in PhysX."""
    return engine_for(world)(world, Conditions.nominal(world, 1), np.array([True]), 1)


@pytest.mark.parametrize("degrees_above", [-1.0, 1.0, 5.0])
def test_a_block_slides_down_a_slope_above_the_angle_of_friction_and_rests_below(degrees_above: float) -> None:
    """As far as the acceleration g (sin - friction cos) takes it."""
    friction, seconds = 0.6, 0.4
    angle = np.arctan(friction) + radians(degrees_above)
    R = exp_so3(np.array([0.0, angle, 0.0]))
    task = Task(TABLETOP.with_friction(friction), table=Plane(tuple(R[:, 2]), offset=0.0))
    world = build_world(gripper(), load_object("box:0.08,0.08,0.02", candidates=16), task)
    rows, start = rows_of(world), transform(R, 0.01 * R[:, 2])
    rows.place(FAR_HAND, np.zeros((1, 2)), pose_from_transform(start)[None])
    rows.drive(FAR_HAND, np.zeros((1, 2)))
    rows.step(round(seconds / world.protocol.timestep))
    along = R[:, 0] @ (rows.object_poses()[0, :3, 3] - start[:3, 3])
    rate = world.protocol.acceleration * max(np.sin(angle) - friction * np.cos(angle), 0.0)
    assert along == pytest.approx(rate * seconds**2 / 2, rel=0.05, abs=1e-3)
