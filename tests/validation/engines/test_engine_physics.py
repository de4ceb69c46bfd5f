"""Grasps simulated in every engine but MuJoCo against physics that is known in closed form, and against MuJoCo."""

import numpy as np
import pytest

from grasp_refine.closing.motion import Motion
from grasp_refine.core.se3 import exp_so3, transform
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.task import Task
from grasp_refine.validation import simulation
from grasp_refine.validation.engine_table import ENGINES, MUJOCO, engine_of
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.trials import Reason, Trials
from gripper import KP, RADIUS, around, ball, gripper, lifted

PUSH = DEXGRASPBENCH.mass * DEXGRASPBENCH.acceleration
ACROSS = ("+y", "-y", "+z", "-z")


@pytest.fixture(params=[name for name in ENGINES if name != MUJOCO])
def engine(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(gripper(), ball(), Task(DEXGRASPBENCH))


def simulate(
    engine: str, world: World, motion: Motion, conditions: Conditions | None = None, *, threads: int = 1
) -> Trials:
    return simulation.simulate(world, motion, conditions, threads=threads, engine=engine_of(engine, world))


def various(forces: list[float]) -> Motion:
    """Grasps that press with some forces, each a little aside."""
    rng, count = np.random.default_rng(0), len(forces)
    motion = around(0.0, count=count)
    motion.q[:, 2, 0] -= 2 * np.array(forces) / KP
    motion.T_world_root[..., :3, 3] += rng.uniform(-0.003, 0.003, (count, 1, 3))
    motion.T_world_root[:, 2, :3, :3] = exp_so3(rng.uniform(-0.02, 0.02, (count, 3)))
    return motion


def test_a_ball_between_two_plates_holds_when_friction_can_carry_the_push(engine: str, world: World) -> None:
    """Each plate carries half of the push across: it slips when that is above friction x normal force."""
    friction = np.array([0.3, 1.0])
    held, dropped = (
        simulate(
            engine,
            world,
            Motion(*exact(factor * PUSH / (2 * friction))),
            Conditions(np.tile(np.eye(4), (2, 1, 1)), friction),
        )
        for factor in (1.03, 0.97)
    )
    across = [held.directions.index(name) for name in ACROSS]
    assert (held.reason[:, across] == Reason.HELD).all()
    assert (dropped.reason[:, across] == Reason.MOVED).all()
    # Below its limit friction holds: what creeps is slower than the speed that regularises it, for two seconds.
    assert held.displacement_m[:, across].max() < 1.5e-3


def exact(forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return poses and values of grasps that press with these forces."""
    parts = [around(force) for force in forces]
    return np.concatenate([part.T_world_root for part in parts]), np.concatenate([part.q for part in parts])


def test_a_push_along_the_plates_normal_is_carried_by_both_actuators(engine: str, world: World) -> None:
    trials = simulate(engine, world, around(4.0))
    along = trials.displacement_m[0, [trials.directions.index("+x"), trials.directions.index("-x")]]
    assert along == pytest.approx([PUSH / (2 * KP)] * 2, rel=0.15)


def test_bad_starts_fail_with_mujocos_reasons_and_harm_no_other(engine: str, world: World) -> None:
    """Numbers that are not finite, a deep start; and all numbers are independent of threads and of the batch."""
    motion = various([4.0, 4.0, 4.0, 0.5])
    motion.q[1, 2] = np.nan
    motion.q[2, 0] = 2 * RADIUS - 0.03
    trials, other = simulate(engine, world, motion, threads=2), simulation.simulate(world, motion)
    assert trials.success.tolist() == other.success.tolist() == [True, False, False, False]
    np.testing.assert_array_equal(trials.reason[:3], other.reason[:3])
    assert (trials.reason[1] == Reason.NOT_FINITE).all() and (trials.reason[2] == Reason.PENETRATES).all()
    assert trials.penetration_m[2] == pytest.approx(0.015, abs=1e-3)
    for name in ("displacement_m", "closing_m"):
        np.testing.assert_array_equal(np.isnan(getattr(trials, name)), np.isnan(getattr(other, name)))
    np.testing.assert_array_equal(trials.contacts_squeeze, other.contacts_squeeze)
    alone = Trials.join([simulate(engine, world, motion.select(np.array([row]))) for row in (3, 0)])
    for name in ("reason", "time_s", "displacement_m", "angle_rad", "contacts", "closing_m", "penetration_m"):
        np.testing.assert_array_equal(getattr(trials, name)[[3, 0]], getattr(alone, name), err_msg=name)


def test_an_object_is_lifted_off_a_table_or_dropped(engine: str) -> None:
    """By a hand from the side; one that reaches into the table is named."""
    world = build_world(gripper(), ball(), Task(TABLETOP))
    aside = transform(exp_so3(np.array([np.pi / 2, 0.0, 0.0])), np.zeros(3))
    parts = lifted(around(8.0)), lifted(around(0.05)), lifted(around(8.0), -0.005), around(8.0)
    T, q = np.concatenate([part.T_world_root for part in parts]), np.concatenate([part.q for part in parts])
    T[3] = transform(np.eye(3), np.array([0.0, 0.0, 0.015])) @ aside @ T[3]
    trials = simulate(engine, world, Motion(T, q))
    assert trials.directions == ("lift",)
    # The plates reach 4 cm down, the ball lies on its radius of 3 cm.
    assert trials.reason[:, 0].tolist() == [Reason.HELD, Reason.MOVED, Reason.IN_TABLE, Reason.HELD]
    assert trials.displacement_m[[0, 3]].max() < 0.02


def test_a_simulation_that_diverges_is_unstable_and_the_next_one_is_not(engine: str, world: World) -> None:
    """In the same workspace, whose clock the solver has left."""
    wrench = np.zeros((2, 1, 6))
    wrench[0, 0, 1], wrench[1, 0, 1] = 1e300, 0.5
    conditions = Conditions(np.tile(np.eye(4), (2, 1, 1)), np.full(2, 0.6), wrench=wrench)
    trials = simulate(engine, world, around(4.0, count=2), conditions)
    assert trials.reason[:, 0].tolist() == [Reason.UNSTABLE, Reason.HELD]
    alone = simulate(engine, world, around(4.0), conditions.select(np.array([1])))
    np.testing.assert_array_equal(trials.displacement_m[1], alone.displacement_m[0])
