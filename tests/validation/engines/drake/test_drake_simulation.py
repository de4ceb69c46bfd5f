"""Grasps simulated in Drake against physics that is known in closed form, and against MuJoCo."""

from math import radians

import numpy as np
import pytest

from grasp_refine.core.se3 import exp_se3, pose_from_transform, transform
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.strict import STRICT
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.task import Task
from grasp_refine.validation import simulation
from grasp_refine.validation.engines.drake.contacts import CONTACT_STIFFNESS_N_M
from grasp_refine.validation.engines.drake.rows import Rows, engine_for
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import World, build_world
from gripper import KP, RADIUS, around, ball, gripper, lifted, weighing


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


def test_the_root_goes_to_where_the_motion_says_and_is_raised_along_z_of_the_world() -> None:
    """From any pose to any other; its own weight bends no hand."""
    world = build_world(gripper(), ball(), Task(TABLETOP, table=Plane(offset=-50.0)))
    start, end = exp_se3(np.random.default_rng(1).normal(size=(2, 6)) * [0.05, 0.05, 0.05, 0.9, 0.6, 0.9])
    rows = engine_for(world)(world, Conditions.nominal(world, 1), np.array([True]), 1)
    far = np.array([[0.0, 0, 5, 1, 0, 0, 0]])
    rows.place(pose_from_transform(start[None]), np.array([[0.005, -0.005]]), far)
    crossed = rows.touching(np.array([0]))
    assert not crossed.links.any() and crossed.depth[0] == crossed.depth_table[0] == 0.0, "plates in each other"
    rows.place(pose_from_transform(start[None]), np.zeros((1, 2)), far)
    np.testing.assert_allclose(palm(rows), start, atol=1e-9)
    rows.drive(pose_from_transform(end[None]), np.zeros((1, 2)))
    rows.step(200)
    np.testing.assert_allclose(palm(rows), end, atol=1e-4)
    rows.resume(rows.state())
    rows.raise_to(0.02)
    rows.step(200)
    np.testing.assert_allclose(palm(rows), transform(end[:3, :3], end[:3, 3] + [0.0, 0.0, 0.02]), atol=1e-4)
    assert np.abs(rows._moving[:, rows._plant.joints]).max() < 1e-5


def palm(rows: Rows) -> np.ndarray:
    """Return the pose (4, 4) of the palm in the first simulation."""
    with rows._spaces[0].borrow() as space:
        space.load(rows._start[0], rows._set_points[0], rows._moving[0], rows._wrench[0])
        plant = rows._plant.plant
        return plant.GetBodyByName("hand/palm").EvalPoseInWorld(space._context).GetAsMatrix4()


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
    rows = made[-1]
    off = np.abs(rows._moving[:, rows._plant.root] - rows._set_points[:, rows._plant.root_servos])
    # On the lift the palm follows its set points a little later.
    assert off[:, : 2 if protocol.tabletop else 3].max() < 1e-4
    assert off[:, 3:].max() < radians(0.1)
