"""Models of every engine but MuJoCo against the same models in MuJoCo: motion of every kind of joint, servo and tie."""

from dataclasses import replace
from math import radians

import numpy as np
import pytest

from engine_rows import both, driven, joints, palm, root_errors
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_se3, pose_from_transform, transform, transform_from_pose
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.strict import STRICT
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.task import Task
from grasp_refine.validation import simulation
from grasp_refine.validation.engine_table import ENGINES, MUJOCO, engine_of
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import build_world
from gripper import around, ball, gripper, lifted, two_balls, weighing
from rich_hands import LEFT, NAMES, TIED, TIES, model, random_poses, rich, unlimited

every = pytest.mark.parametrize("engine", [name for name in ENGINES if name != MUJOCO])
FAR = Plane(offset=-50.0)


@pytest.mark.parametrize(("engine", "tendon"), [("drake", False), ("drake", True), ("physx", False)])
def test_hand_and_object_move_as_in_mujoco(engine: str, tendon: bool) -> None:
    """Gears, ctrlrange, springs, armature, damping, masses, inertias; in Drake force limits and a tendon of springs;
    and a wrench at the centre of mass."""
    limited = engine == "drake"
    protocol = replace(TABLETOP, timestep=1e-4)
    hand = rich(tendon=tendon) if limited else unlimited()
    world = build_world(hand, two_balls((0.02, 0.012), (0.03, -0.02)), Task(protocol, table=FAR))
    assert np.linalg.norm(world.model.body_ipos[world.object_body]) > 0.005
    conditions = replace(Conditions.nominal(world, 3), mass=np.array([0.1, 0.1, 0.3]), gain=np.array([1.0, 1.5, 1.0]))
    conditions = replace(conditions, force_limit=np.array([1.0, 0.6, 1.0])) if limited else conditions
    rng = np.random.default_rng(3)
    start = rng.uniform([-0.5, -0.5, 0, -0.005], [0.5, 0.5, 0.6, 0.005], (3, 4))
    aim = rng.uniform(-1.5, 1.5, (3, 5)) * [4, 1, 0.02, 1, 0.5]
    aim[2] *= not limited
    root, place = random_poses(3, 4), random_poses(3, 5) + [1.0, 0, 0, 0, 0, 0, 0]
    wrench = rng.normal(size=(3, 6)) * [2, 2, 2, 0.01, 0.01, 0.01]
    rows = both(engine, world, conditions)
    for one in rows:
        one.place(root, start, place)
        one.drive(root, aim)
        one.push(wrench)
    moved = []
    for _ in range(3):
        for one in rows:
            one.step(150)
        moved.append([joints(rows[0]) - start, rows[1].batch.qpos[:, world.joints_at] - start])
        poses = [one.object_poses() for one in rows]
        np.testing.assert_allclose(poses[0], poses[1], atol=5e-4)
    found, expected = np.array(moved).transpose(1, 0, 2, 3)
    largest = np.abs(expected).max(axis=(0, 1))
    assert (largest > [0.2, 0.2, 0.2, 2e-3]).all()
    assert (np.abs(found - expected).max(axis=(0, 1)) < (0.02 if limited else 0.03) * largest).all()
    centre = world.model.body_ipos[world.object_body]
    found, before = poses[0] @ [*centre, 1], transform_from_pose(place) @ [*centre, 1]
    # Semi-implicit Euler: the sum of n velocities.
    rate = wrench[:, :3] / conditions.mass[:, None] - [0.0, 0.0, 9.81]
    np.testing.assert_allclose((found - before)[:, :3], rate * protocol.timestep**2 * 450 * 451 / 2, atol=1e-5)


@every
@pytest.mark.parametrize("aim", [0.5, -0.9])
def test_ties_of_bodies_and_joints_hold(engine: str, aim: float) -> None:
    """A parallelogram, closed at a part of its other side; a welded twin; and a follower, from reference positions."""
    left, bar, right, twin, follower = driven(engine, model(TIED.format(more=""), NAMES, TIES), aim)
    turned = left + np.radians(20)
    assert left == pytest.approx(aim, abs=0.01)
    np.testing.assert_allclose([-bar, right, twin], turned, atol=2e-3)
    assert follower == pytest.approx(np.radians(10) + 0.1 + 0.5 * turned, abs=2e-3)


@every
def test_a_limit_of_a_joint_stops_it(engine: str) -> None:
    servos = LEFT.replace("</actuator>", '<position joint="right" kp="1"/></actuator>')
    stopped = model(TIED.format(more='range="-60 17.188733853924695"'), NAMES, servos)
    assert driven(engine, stopped, 0.0, 2.0)[2] == pytest.approx(0.3, abs=0.01)


JOINED = f'<equality><joint joint1="left" joint2="right" polycoef="0 1 1"/></equality>{LEFT}'
AT_SITE = '<actuator><position site="s" kp="1"/></actuator>'
TWICE = '<actuator><position joint="left" kp="1" forcerange="-1 1"/><position joint="left" kp="2"/></actuator>'


@pytest.mark.parametrize(
    ("engine", "more"), [*((name, more) for name in ("drake", "physx") for more in (JOINED, AT_SITE)), ("physx", TWICE)]
)
def test_parts_without_a_counterpart_are_refused(engine: str, more: str) -> None:
    with pytest.raises(GraspRefineError, match=engine):
        driven(engine, model(TIED.format(more="").replace("<geom", '<site name="s"/><geom', 1), NAMES, more), 0.0)
    world = build_world(model(TIED.format(more=""), NAMES, LEFT), ball(), Task(DEXGRASPBENCH))
    with pytest.raises(GraspRefineError, match="mujoco"):
        both(engine, world, replace(Conditions.nominal(world, 1), default_contact=np.array([True])))


@every
def test_the_root_goes_to_where_the_motion_says_and_is_raised_along_z_of_the_world(engine: str) -> None:
    """From any pose to any other; its own weight bends no hand."""
    world = build_world(gripper(), ball(), Task(TABLETOP, table=FAR))
    start, end = exp_se3(np.random.default_rng(1).normal(size=(2, 6)) * [0.05, 0.05, 0.05, 0.9, 0.6, 0.9])
    (rows, _), far = both(engine, world, Conditions.nominal(world, 1)), np.array([[0.0, 0, 5, 1, 0, 0, 0]])
    rows.place(pose_from_transform(start[None]), np.array([[0.005, -0.005]]), far)
    crossed = rows.touching(np.array([0]))
    assert not crossed.links.any() and crossed.depth[0] == crossed.depth_table[0] == 0.0, "plates in each other"
    rows.place(pose_from_transform(start[None]), np.zeros((1, 2)), far)
    np.testing.assert_allclose(palm(rows), start, atol=1e-9 if engine == "drake" else 1e-6)
    rows.drive(pose_from_transform(end[None]), np.zeros((1, 2)))
    rows.step(200)
    np.testing.assert_allclose(palm(rows), end, atol=1e-4)
    rows.resume(rows.state())
    rows.raise_to(0.02)
    rows.step(200)
    np.testing.assert_allclose(palm(rows), transform(end[:3, :3], end[:3, 3] + [0.0, 0.0, 0.02]), atol=1e-4)
    assert engine == "physx" or np.abs(joints(rows)).max() < 1e-5


@every
@pytest.mark.parametrize(("protocol", "hand_kg"), [(STRICT, 0.05), (TABLETOP, 5.0), (TABLETOP, 0.05)])
def test_the_palm_gives_way_to_no_load_whatever_it_weighs(engine: str, protocol: Protocol, hand_kg: float) -> None:
    world = build_world(weighing(hand_kg), ball(), Task(protocol.with_mass(1.0)))
    begin, made = engine_of(engine, world), []

    def noted(*arguments: object) -> object:
        made.append(begin(*arguments))
        return made[-1]

    motion = around(25.0)
    motion = lifted(motion, y=0.01) if protocol.tabletop else motion
    assert simulation.simulate(world, motion, threads=1, engine=noted).success.all()
    off = root_errors(made[-1])
    # On the lift the palm follows its set points a little later.
    assert off[:, : 2 if protocol.tabletop else 3].max() < 1e-4
    assert off[:, 3:].max() < radians(0.1)
