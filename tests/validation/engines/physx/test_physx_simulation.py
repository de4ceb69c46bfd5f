"""Grasps simulated in PhysX against physics that is known in closed form."""

from math import radians

import numpy as np
import pytest

from grasp_refine.core.se3 import exp_se3, exp_so3, pose_from_transform, transform, transform_from_pose
from grasp_refine.objects.object import load_object
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.strict import STRICT
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.task import Task
from grasp_refine.validation import simulation
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.engines.physx.rows import ROOT_JOINTS, Rows, engine_for
from gripper import around, ball, gripper, lifted, weighing

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


def test_the_root_goes_to_where_the_motion_says_and_is_raised_against_gravity() -> None:
    """From any pose to any other; its own weight bends no hand."""
    world = build_world(gripper(), ball(), Task(TABLETOP, table=Plane(offset=-50.0)))
    start, end = exp_se3(np.random.default_rng(1).normal(size=(2, 6)) * [0.05, 0.05, 0.05, 0.9, 0.6, 0.9])
    rows, far = rows_of(world), np.array([[0.0, 0, 5, 1, 0, 0, 0]])
    rows.place(pose_from_transform(start[None]), np.zeros((1, 2)), far)
    np.testing.assert_allclose(palm(rows), start, atol=1e-6)
    rows.drive(pose_from_transform(end[None]), np.zeros((1, 2)))
    rows.step(200)
    np.testing.assert_allclose(palm(rows), end, atol=1e-4)
    rows.resume(rows.state())
    rows.raise_to(0.02)
    rows.step(200)
    np.testing.assert_allclose(palm(rows), transform(end[:3, :3], end[:3, 3] + [0.0, 0.0, 0.02]), atol=1e-4)


def palm(rows: Rows) -> np.ndarray:
    """Return the pose (4, 4) of the palm in the first simulation, by the joints of its root."""
    values = rows._moving[0, :ROOT_JOINTS]
    R = np.eye(3)
    for axis, value in zip(np.eye(3), values[3:], strict=True):
        R = R @ exp_so3(value * axis)
    return transform_from_pose(rows._start)[0] @ transform(R, values[:3])


@pytest.mark.parametrize(("protocol", "hand_kg"), [(STRICT, 0.05), (TABLETOP, 5.0), (TABLETOP, 0.05)])
def test_the_palm_gives_way_to_no_load_whatever_it_weighs(protocol: Protocol, hand_kg: float) -> None:
    world = build_world(weighing(hand_kg), ball(), Task(protocol.with_mass(1.0)))
    begin, made = engine_for(world), []

    def engine(*arguments: object) -> Rows:
        made.append(begin(*arguments))
        return made[-1]

    motion = around(25.0)
    motion = lifted(motion, y=0.01) if protocol.tabletop else motion
    assert simulation.simulate(world, motion, threads=1, engine=engine).success.all()
    off = np.abs(made[-1]._moving[:, :ROOT_JOINTS] - made[-1]._targets[:, :ROOT_JOINTS])
    # On the lift the palm follows its set points a little later.
    assert off[:, : 2 if protocol.tabletop else 3].max() < 1e-4
    assert off[:, 3:].max() < radians(0.1)
