"""An object that is pulled live: the physics of a push, of a spring, and of a body that nothing holds."""

from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.closing.motion import Motion
from grasp_refine.core.se3 import log_so3, transform_from_pose
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.protocol import AXES
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.replay.live_pull import MAX_PULL_N, STIFFNESS_N_M, LivePull, Pull
from grasp_refine.validation.simulation import Closed, close, push
from grasp_refine.validation.trials import Reason
from gripper import RADIUS, around, ball, gripper, lifted

NONE = Pull(np.zeros(3))


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(gripper(), ball(), Task(DEXGRASPBENCH))


def closed(world: World, motion: Motion) -> Closed:
    return close(world, motion, Conditions.nominal(world, 1))


def free(world: World) -> LivePull:
    """A ball between plates that do not touch it."""
    motion = around(4.0)
    return LivePull(world, closed(world, replace(motion, q=np.full_like(motion.q, 2 * RADIUS + 0.03))))


def displacement(live: LivePull) -> np.ndarray:
    return live.replay("", "").object_pose[1, :3]


def test_a_steady_pull_is_the_push_of_a_trial_to_the_last_bit(world: World) -> None:
    start, protocol = closed(world, around(4.0)), world.protocol
    for direction in ("+x", "-z"):
        live = LivePull(world, start)
        force = world.mass * protocol.acceleration * np.array(AXES[direction])
        for _ in range(protocol.checks):
            live.advance(protocol.steps_per_check * protocol.timestep, Pull(force))
        trials = push(world, start, directions=(direction,))
        assert (live.moved_m, live.turned_rad) == (trials.displacement_m[0, 0], trials.angle_rad[0, 0])
        assert live.reason == trials.reason[0, 0] == Reason.HELD
        assert live.strongest_n == pytest.approx(np.linalg.norm(force))
        assert live.time == pytest.approx(protocol.seconds)


def test_a_free_object_moves_as_newton_says(world: World) -> None:
    live, force = free(world), np.array([0.0, 0.0, 0.05])
    for _ in range(10):
        live.advance(0.04, Pull(force))
    # Half an acceleration times the square of the time; Euler's steps add one step to the time.
    step = world.protocol.timestep
    np.testing.assert_allclose(displacement(live), 0.5 * force / world.mass * live.time * (live.time + step), rtol=1e-6)
    for _ in range(25):
        live.advance(0.04, Pull(np.array([0.0, 0.0, 10 * MAX_PULL_N])))
    assert np.linalg.norm(live.force) == pytest.approx(MAX_PULL_N)
    assert live.reason == Reason.MOVED and live.moved_m > world.protocol.farthest


def test_a_spring_brings_a_free_object_to_its_end_without_overshoot_and_turns_it_by_its_arm(world: World) -> None:
    centre, end = np.zeros(3), np.array([0.0, 0.0, 0.02])
    live, heights = free(world), []
    for _ in range(20):
        live.advance(0.04, Pull(np.zeros(3), centre, end))
        heights.append(displacement(live)[2])
    assert heights[-1] == pytest.approx(0.02, rel=1e-3) and max(heights) < 0.0204
    assert np.linalg.norm(live.force) < 0.01
    # r x F of a point above the centre that is pulled along y is along -x.
    live = free(world)
    live.advance(0.02, Pull(np.zeros(3), np.array([0.0, 0.0, RADIUS]), np.array([0.0, 0.001, RADIUS])))
    turn = log_so3(transform_from_pose(live.replay("", "").object_pose[1:])[0, :3, :3])
    assert turn[0] < -1e-4 and abs(turn[1:]).max() < 1e-6


def test_a_held_object_yields_until_the_spring_is_balanced(world: World) -> None:
    live = LivePull(world, closed(world, around(4.0)))
    for _ in range(40):
        live.advance(0.04, Pull(np.zeros(3), np.zeros(3), np.array([0.01, 0.0, 0.0])))
    stretched = np.array([0.01, 0.0, 0.0]) - displacement(live)
    np.testing.assert_allclose(live.force, STIFFNESS_N_M * stretched, atol=0.02)
    assert live.reason == Reason.HELD and 0.5 < live.strongest_n < 2.0


def test_a_lost_object_stays_lost_and_the_largest_force_that_was_held_is_kept(world: World) -> None:
    live = LivePull(world, closed(world, around(4.0)))
    newtons, most = 0.0, 0.0
    while live.reason == Reason.HELD:
        most, newtons = newtons, newtons + 0.25
        live.advance(0.2, Pull(np.array([0.0, newtons, 0.0])))
        assert newtons < 30.0
    # Coulomb: both plates press with about 4 N.
    assert 0.5 * 2 * 0.6 * 4.0 < most < 2.0 * 2 * 0.6 * 4.0
    assert live.strongest_n == pytest.approx(most)
    for _ in range(3):
        live.advance(0.04, NONE)
    assert live.reason != Reason.HELD and live.strongest_n == pytest.approx(most)


def test_off_a_table_the_object_is_lifted_and_judged_where_the_hand_takes_it() -> None:
    world = build_world(gripper(), ball(), Task(TABLETOP))
    live = LivePull(world, closed(world, lifted(around(8.0))))
    while live.time < world.protocol.seconds + 0.2:
        live.advance(0.04, NONE)
    assert displacement(live)[2] == pytest.approx(world.protocol.lift, abs=0.01)
    assert live.reason == Reason.HELD and live.moved_m < 0.01
