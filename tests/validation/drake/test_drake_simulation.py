"""Grasps simulated in Drake against physics that is known in closed form, and against MuJoCo."""

from dataclasses import replace
from math import radians

import mujoco
import numpy as np
import pytest

from grasp_refine.closing.motion import Motion
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_so3
from grasp_refine.hands.files.defaults import Actuator
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.protocol import AXES, Protocol
from grasp_refine.scene.protocols.strict import STRICT
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.task import Task
from grasp_refine.validation import simulation
from grasp_refine.validation.engine_choice import engine_of
from grasp_refine.validation.engines.drake.build import build_plant
from grasp_refine.validation.engines.drake.contacts import touching_pairs
from grasp_refine.validation.engines.drake.plant import Parameters
from grasp_refine.validation.engines.drake.rows import Plants, Rows
from grasp_refine.validation.engines.mujoco.hand_model import HandModel
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.trials import Reason, Trials
from gripper import KP, RADIUS, around, ball, gripper, lifted, weighing

PUSH = DEXGRASPBENCH.mass * DEXGRASPBENCH.acceleration
ACROSS = ("+y", "-y", "+z", "-z")

FINGER = """
<mujoco>
  <worldbody>
    <body name="palm">
      <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
      {palm}
      <body name="first" pos="0 0 0.1">
        <joint name="first" axis="0 1 0" damping="0.05" range="-90 40" {first}/>
        <geom type="capsule" size="0.005" fromto="0.01 0 0 0.03 0 0" mass="0.05"/>
        <body name="second" pos="0.04 0 0">
          <joint name="second" axis="0 1 0" damping="0.05"/>
          <geom type="capsule" size="0.005" fromto="0.01 0 0 0.03 0 0" mass="0.05"/>
        </body>
      </body>
    </body>
  </worldbody>
  {extra}
</mujoco>
"""
"""A finger of two joints; angles in degrees."""


def simulate(world: World, motion: Motion, conditions: Conditions | None = None, *, threads: int = 1) -> Trials:
    """Trials in Drake."""
    return simulation.simulate(world, motion, conditions, threads=threads, engine=engine_of("drake", world))


def finger(extra: str, first: str = "", palm: str = "") -> World:
    """World of the finger, with a ball far from it."""
    spec = mujoco.MjSpec.from_string(FINGER.format(extra=extra, first=first, palm=palm))
    none = np.zeros(2)
    model = HandModel(
        spec=spec,
        root="palm",
        T_base_root=np.eye(4),
        joints=("first", "second"),
        matrix=np.eye(2),
        offset=none,
        links={name: name for name in ("palm", "first", "second")},
        notes=(),
        actuator=Actuator(none, none, none, none, none),
    )
    return build_world(model, ball(), Task(DEXGRASPBENCH))


def one(world: World, count: int = 1) -> Rows:
    """Simulations of a world, its hand and object at rest at the origin."""
    rows = Plants(world).simulations(world, Conditions.nominal(world, count), np.ones(count, dtype=bool), threads=1)
    origin = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (count, 1))
    far = origin + [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0]
    rows.place(origin, np.zeros((count, len(world.joints_at))), far)
    return rows


def drive(rows: Rows, *set_points: float) -> None:
    rows.drive(np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]), np.array([set_points]))


def joints(rows: Rows) -> np.ndarray:
    """Values of the joints of the first simulation."""
    return rows.state()[0, -len(rows._moving[0]) :][rows._plant.joints]


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(gripper(), ball(), Task(DEXGRASPBENCH))


def holds(world: World, force: float, friction: float, **conditions: np.ndarray) -> Trials:
    return simulate(world, around(force), Conditions(np.eye(4)[None], np.array([friction]), **conditions), threads=1)


def test_a_free_object_accelerates_by_force_over_mass(world: World) -> None:
    rows, mass = one(world, len(AXES)), DEXGRASPBENCH.mass
    force = PUSH * np.array(list(AXES.values()))
    start = rows.object_poses()[:, :3, 3]
    rows.push(np.pad(force, ((0, 0), (0, 3))))
    count = 100
    rows.step(count)
    # Semi-implicit Euler: the sum of n velocities.
    seconds = DEXGRASPBENCH.timestep
    expected = force / mass * seconds**2 * count * (count + 1) / 2
    np.testing.assert_allclose(rows.object_poses()[:, :3, 3] - start, expected, atol=1e-9)
    np.testing.assert_allclose(rows.object_poses()[:, :3, :3], np.tile(np.eye(3), (6, 1, 1)), atol=1e-9)


def test_a_torque_turns_a_free_object_by_its_inertia(world: World) -> None:
    rows, torque = one(world), 1e-5
    rows.push(np.array([[0.0, 0.0, 0.0, 0.0, torque, 0.0]]))
    rows.step(100)
    seconds, inertia = DEXGRASPBENCH.timestep, 0.4 * DEXGRASPBENCH.mass * RADIUS**2
    turned = torque / inertia * seconds**2 * 100 * 101 / 2
    np.testing.assert_allclose(rows.object_poses()[0, :3, :3], exp_so3(np.array([0.0, turned, 0.0])), atol=1e-4)


@pytest.mark.parametrize("friction", [0.3, 0.6, 1.0])
def test_a_ball_between_two_plates_holds_when_friction_can_carry_the_push(world: World, friction: float) -> None:
    # Each plate carries half of the push across: it slips when that is above friction x normal force.
    limit = PUSH / (2 * friction)
    held, dropped = holds(world, 1.03 * limit, friction), holds(world, 0.97 * limit, friction)
    across = [held.directions.index(name) for name in ACROSS]
    assert (held.reason[0, across] == Reason.HELD).all()
    assert (dropped.reason[0, across] == Reason.MOVED).all()
    # Below its limit friction holds: what creeps is slower than the speed that regularises it, for two seconds.
    assert held.displacement_m[0, across].max() < 1.5e-3


def test_a_heavier_object_needs_more_force(world: World) -> None:
    # Pushed by the same wrench, mass is of no matter; a push in proportion to mass needs another world.
    wrench = PUSH * np.pad(np.array([AXES["+y"]]), ((0, 0), (0, 3)))[None]
    limit = PUSH / (2 * 0.6)
    for mass in (0.05, 0.5):
        given = {"mass": np.array([mass]), "wrench": wrench}
        assert holds(world, 1.05 * limit, 0.6, **given).success.all()
        lost = holds(world, 0.9 * limit, 0.6, **given)
        assert lost.directions == ("wrench 1",) and not lost.success.any()
    # What slips is the faster the lighter it is.
    light, heavy = (holds(world, 0.5 * limit, 0.6, mass=np.array([m]), wrench=wrench) for m in (0.05, 0.5))
    assert light.displacement_m[0, 0] > 2 * heavy.displacement_m[0, 0]


def test_gain_and_force_limit_of_the_servos_press_as_much(world: World) -> None:
    limit = PUSH / (2 * 0.6)
    twice = np.array([2.0])
    assert not holds(world, 0.6 * limit, 0.6).success.any()
    assert holds(world, 0.6 * limit, 0.6, gain=twice).success.all()
    spec = gripper()
    for servo in spec.spec.actuators:
        servo.forcelimited, servo.forcerange = True, [-0.9 * limit, 0.9 * limit]
    limited = build_world(spec, ball(), Task(DEXGRASPBENCH))
    assert not holds(limited, 4 * limit, 0.6).success.any()
    assert holds(limited, 4 * limit, 0.6, force_limit=np.array([1.2])).success.all()


def test_a_push_along_the_plates_normal_is_carried_by_both_actuators(world: World) -> None:
    trials = holds(world, 4.0, 0.6)
    along = trials.displacement_m[0, [trials.directions.index("+x"), trials.directions.index("-x")]]
    assert along == pytest.approx([PUSH / (2 * KP)] * 2, rel=0.15)


def test_a_servo_presses_with_its_gain_times_its_error_on_a_stop_and_with_no_more_than_its_limit() -> None:
    # The first joint holds the second's torque by a spring: it yields by torque over stiffness.
    servos = (
        '<actuator><position joint="first" kp="20"/><position joint="second" kp="2" {limit}/></actuator>'
        '<equality><joint joint1="first" joint2="second" polycoef="0 1"/></equality>'
    )
    for limit, torque in (("", None), ('forcerange="-0.3 0.3"', 0.3)):
        rows = one(finger(servos.format(limit=limit)))
        drive(rows, 0.0, 0.5)
        rows.step(400)
        q = joints(rows)
        # Both are one joint, at 20 q = min(2 (0.5 - q), limit).
        expected = (2 * 0.5) / 22 if torque is None else torque / 20
        np.testing.assert_allclose(q, expected, rtol=0.02)


def test_a_joint_stops_at_its_limit_and_a_spring_and_a_reference_are_as_in_the_file() -> None:
    servos = '<actuator><position joint="first" kp="5"/><position joint="second" kp="5"/></actuator>'
    rows = one(finger(servos))
    drive(rows, 2.0, 0.0)
    rows.step(400)
    assert joints(rows)[0] == pytest.approx(np.radians(40), abs=0.01)
    rows = one(finger(servos, first='stiffness="5" springref="30"'))
    drive(rows, 0.0, 0.0)
    rows.step(600)
    assert joints(rows)[0] == pytest.approx(np.radians(15), abs=0.005)


def test_dry_friction_of_a_joint_holds_against_less_and_slows_more() -> None:
    servos = '<actuator><position joint="first" kp="1"/><position joint="second" kp="1"/></actuator>'
    rows = one(finger(servos, first='frictionloss="0.2"'))
    drive(rows, 0.15, 0.0)
    rows.step(500)
    assert abs(joints(rows)[0]) < 2e-3
    drive(rows, 0.6, 0.0)
    rows.step(1500)
    # It comes to rest where the servo no longer overcomes it.
    assert joints(rows)[0] == pytest.approx(0.4, abs=0.01)


def test_coupled_joints_keep_their_ratio() -> None:
    servos = (
        '<actuator><position joint="second" kp="3"/></actuator>'
        '<equality><joint joint1="first" joint2="second" polycoef="0.1 0.5"/></equality>'
    )
    rows = one(finger(servos))
    for _ in range(8):
        drive(rows, 0.8)
        rows.step(50)
        first, second = joints(rows)
        assert first == pytest.approx(0.1 + 0.5 * second, abs=2e-3)
    assert second == pytest.approx(0.8, abs=0.02)


def test_a_servo_on_a_tendon_pulls_the_weighted_sum_of_its_joints() -> None:
    tendon = (
        '<tendon><fixed name="both"><joint joint="first" coef="1"/><joint joint="second" coef="0.5"/></fixed></tendon>'
        '<actuator><position tendon="both" kp="4" {limit}/></actuator>'
    )
    stiff = 'stiffness="1"'
    # Springs of 1 N m/rad at the first joint alone: the tendon's torque goes to the second one until it has its sum.
    rows = one(finger(tendon.format(limit=""), first=stiff))
    drive(rows, 0.6)
    rows.step(1500)
    first, second = joints(rows)
    assert first + 0.5 * second == pytest.approx(0.6, abs=0.01) and abs(first) < 0.02
    # With a spring at the first joint only and the second at rest against it, force is at most its limit.
    both = finger(
        tendon.format(limit='forcerange="-0.2 0.2"')
        + '<equality><joint joint1="second" joint2="first" polycoef="0 0"/></equality>',
        first=stiff,
    )
    rows = one(both)
    drive(rows, 5.0)
    rows.step(800)
    assert joints(rows) == pytest.approx([0.2, 0.0], abs=5e-3)


def test_masses_and_inertias_are_as_in_mujoco(world: World) -> None:
    plant = build_plant(world, Parameters(0.6, world.mass))
    context = plant.plant.CreateDefaultContext()
    total = plant.plant.CalcTotalMass(context)
    assert total == pytest.approx(world.model.body_mass.sum(), rel=1e-12)
    data = mujoco.MjData(world.model)
    mujoco.mj_forward(world.model, data)
    moving = np.zeros((world.model.nv, world.model.nv))
    for column, unit in zip(moving, np.eye(world.model.nv), strict=True):
        mujoco.mj_mulM(world.model, data, column, unit)
    # Two sliding joints come last in both.
    np.testing.assert_allclose(plant.plant.CalcMassMatrix(context)[-2:, -2:], moving[-2:, -2:], rtol=1e-9)


def test_the_pairs_that_may_touch_are_as_in_mujoco() -> None:
    servos = '<actuator><position joint="first" kp="1"/></actuator>'
    excluded = '<contact><exclude body1="palm" body2="second"/></contact>'
    palm = '<geom name="palm" type="sphere" size="0.01" contype="{bits}" conaffinity="{bits}"/>'
    found = []
    for extra, bits in ((servos, 1), (servos + excluded, 1), (servos, 2), (servos, 0)):
        model = finger(extra, palm=palm.format(bits=bits)).model
        # Within so large a margin all pairs are contacts, but for those that are never tried.
        model.geom_margin[:] = 10.0
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        pairs = {tuple(sorted(pair)) for pair in data.contact.geom.tolist()}
        assert pairs == {tuple(sorted(pair)) for pair in touching_pairs(model)}
        found.append(len(pairs))
    # Palm and second link touch, and each the ball; the first link is the parent of one and the child of the other.
    assert found == [4, 3, 3, 2]


def test_a_deep_start_and_numbers_that_are_not_finite_fail_with_mujocos_reasons(world: World) -> None:
    motion = around(4.0, count=4)
    q = motion.q.copy()
    q[1, 2] = np.nan
    q[2, 0] = 2 * RADIUS - 0.03
    trials = simulate(world, Motion(motion.T_world_root, q), threads=1)
    other = simulation.simulate(world, Motion(motion.T_world_root, q))
    assert trials.success.tolist() == [True, False, False, True]
    np.testing.assert_array_equal(trials.reason, other.reason)
    assert (trials.reason[1] == Reason.NOT_FINITE).all() and (trials.reason[2] == Reason.PENETRATES).all()
    assert trials.penetration_m[2] == pytest.approx(0.015, abs=1e-3)
    np.testing.assert_array_equal(np.isnan(trials.displacement_m), np.isnan(other.displacement_m))
    np.testing.assert_array_equal(np.isnan(trials.closing_m), np.isnan(other.closing_m))
    np.testing.assert_array_equal(trials.contacts_squeeze, other.contacts_squeeze)


def test_results_depend_neither_on_threads_nor_on_the_batch(world: World) -> None:
    rng = np.random.default_rng(0)
    count = 5
    motion = around(0.0, count=count)
    q, T = motion.q.copy(), motion.T_world_root.copy()
    q[:, 2, 0] -= 2 * rng.uniform(0.5, 4.0, count) / KP
    T[..., :3, 3] += rng.uniform(-0.003, 0.003, (count, 1, 3))
    T[:, 2, :3, :3] = exp_so3(rng.uniform(-0.02, 0.02, (count, 3)))
    motion = Motion(T, q)
    together, again = (simulate(world, motion, threads=threads) for threads in (2, 1))
    single = Trials.join([simulate(world, motion.select(np.array([row])), threads=1) for row in range(count)])
    assert 0 < together.success.sum() < count
    for name in ("reason", "time_s", "displacement_m", "angle_rad", "contacts", "closing_m", "penetration_m"):
        np.testing.assert_array_equal(getattr(together, name), getattr(again, name), err_msg=name)
        np.testing.assert_array_equal(getattr(together, name), getattr(single, name), err_msg=name)


def test_the_root_goes_to_where_the_motion_says(world: World) -> None:
    rng = np.random.default_rng(1)
    rows = one(world)
    start, end = np.eye(4), np.eye(4)
    end[:3, :3], end[:3, 3] = exp_so3(rng.normal(size=3) * 0.5), [0.03, -0.02, 0.05]
    pose = np.array([0.03, -0.02, 0.05, *_quaternion(end[:3, :3])])[None]
    rows.drive(pose, np.zeros((1, 2)))
    rows.step(200)
    plant = rows._plant
    context = plant.plant.CreateDefaultContext()
    plant.plant.SetPositionsAndVelocities(context, rows._moving[0])
    found = plant.plant.GetBodyByName("hand/palm").EvalPoseInWorld(context).GetAsMatrix4()
    np.testing.assert_allclose(found, start @ end, atol=1e-4)


def _quaternion(R: np.ndarray) -> np.ndarray:
    found = np.zeros(4)
    mujoco.mju_mat2Quat(found, R.ravel())
    return found


def raised(motion: Motion, height: float) -> Motion:
    T = motion.T_world_root.copy()
    T[..., 2, 3] += height
    return Motion(T, motion.q)


def test_an_object_is_lifted_off_a_table_or_dropped() -> None:
    world = build_world(gripper(), ball(), Task(TABLETOP))
    held = simulate(world, raised(around(8.0), 0.015), threads=1)
    dropped = simulate(world, raised(around(0.05), 0.015), threads=1)
    assert held.directions == ("lift",) and held.success.all() and held.displacement_m.max() < 0.02
    assert (dropped.reason == Reason.MOVED).all()
    # The plates reach 4 cm down, the ball lies on its radius of 3 cm.
    deep = simulate(world, raised(around(8.0), -0.005), threads=1)
    assert (deep.reason == Reason.IN_TABLE).all()


def test_other_starts_of_the_object_are_taken(world: World) -> None:
    T = np.eye(4)
    T[:3, 3] = [0.0, 0.2, 0.0]
    away = Conditions(T[None], np.array([0.6]))
    trials = simulate(world, around(4.0), away, threads=1)
    assert not trials.contacts_squeeze.any() and (trials.reason == Reason.MOVED).all()


def test_what_only_mujoco_has_is_refused(world: World) -> None:
    mujocos = replace(Conditions.nominal(world, 1), default_contact=np.array([True]))
    with pytest.raises(GraspRefineError, match="mujoco"):
        simulate(world, around(4.0), mujocos)
    servo = '<actuator><position joint="first" kp="1"/></actuator>'
    bent = '<equality><joint joint1="first" joint2="second" polycoef="0 1 1"/></equality>'
    with pytest.raises(GraspRefineError, match="equality"):
        one(finger(servo + bent))


@pytest.mark.parametrize("protocol", [STRICT, TABLETOP])
@pytest.mark.parametrize("hand_kg", [0.05, 5.0])
def test_the_palm_gives_way_to_no_load_whatever_it_weighs(protocol: Protocol, hand_kg: float) -> None:
    world = build_world(weighing(hand_kg), ball(), Task(protocol.with_mass(1.0)))
    plants, made = Plants(world), []

    def engine(*arguments: object) -> Rows:
        made.append(plants.simulations(*arguments))
        return made[-1]

    motion = around(25.0)
    motion = lifted(motion, y=0.01) if protocol.tabletop else motion
    assert simulation.simulate(world, motion, threads=1, engine=engine).success.all()
    rows = made[-1]
    off = np.abs(rows._moving[:, rows._plant.root] - rows._set_points[:, rows._plant.root_servos])
    # On the lift the palm follows its set points a little later.
    assert off[:, : 2 if protocol.tabletop else 3].max() < 1e-4
    assert off[:, 3:].max() < radians(0.1)
