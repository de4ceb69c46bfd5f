"""Simulated grasps against physics that is known in closed form."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstest

from grasp_refine.closing.motion import Motion
from grasp_refine.core.se3 import exp_so3, log_so3
from grasp_refine.results.simulated import reason_lines
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.noise import Noise
from grasp_refine.scene.protocols.strict import STRICT
from grasp_refine.scene.task import Task
from grasp_refine.validation import simulation
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.replay.record import record
from grasp_refine.validation.replay.replay import Stage
from grasp_refine.validation.robustness import holds_without_squeeze
from grasp_refine.validation.simulation import close, push, simulate
from grasp_refine.validation.trials import Reason, Trials
from gripper import KP, RADIUS, around, ball, gripper

PUSH = DEXGRASPBENCH.mass * DEXGRASPBENCH.acceleration


@pytest.fixture(scope="module")
def world() -> World:
    return build_world(gripper(), ball(), Task(DEXGRASPBENCH))


def holds(world: World, force: float, friction: float) -> Trials:
    conditions = Conditions(np.eye(4)[None], np.array([friction]))
    return simulate(world, around(force), conditions)


def test_a_push_along_the_plates_normal_is_carried_by_both_actuators(world: World) -> None:
    trials = holds(world, 4.0, 0.6)
    along = trials.displacement_m[0, [trials.directions.index("+x"), trials.directions.index("-x")]]
    # The plates are springs in parallel; the root's weld and the contacts give a little more.
    assert along == pytest.approx([PUSH / (2 * KP)] * 2, rel=0.3)
    assert trials.success.all()


def test_links_that_touch_are_reported_by_stage(world: World) -> None:
    trials = holds(world, 4.0, 0.6)
    assert set(trials.links) == {"left plate", "right plate"}
    assert trials.contacts_squeeze.all() and trials.contacts.all()
    early = simulate(world, around(4.0, grasp=2 * RADIUS + 0.006))
    assert not early.contacts_grasp.any() and early.contacts_squeeze.all()


def test_what_is_within_a_gap_does_not_touch() -> None:
    """MuJoCo lists contacts of bodies that are apart where a model of somebody else has gaps."""
    wide = build_world(gripper(), ball(), Task(DEXGRASPBENCH))
    wide.model.geom_gap[:] = 0.02
    early = simulate(wide, around(4.0, grasp=2 * RADIUS + 0.006))
    assert not early.contacts_grasp.any() and early.contacts_squeeze.all()


def test_the_limits_are_as_in_the_protocol() -> None:
    """Where an object may turn a tenth as far, what turned is nearer to being lost than what moved."""
    protocol = replace(DEXGRASPBENCH, steepest=DEXGRASPBENCH.steepest / 10)
    trials = holds(build_world(gripper(), ball(), Task(protocol)), 4.0, 0.6)
    assert trials.limits == (protocol.farthest, protocol.steepest)
    peak_m, peak_rad = np.zeros(trials.reason.shape), np.zeros(trials.reason.shape)
    peak_m[:, 1], peak_rad[:, 4] = 0.8 * protocol.farthest, 0.9 * protocol.steepest
    near = replace(trials, peak_m=peak_m, peak_rad=peak_rad)
    assert (near.worst == 4).all()
    assert (Trials.join([near, near]).worst == 4).all() and (near.select(np.array([0])).worst == 4).all()


def test_deep_penetration_at_the_pregrasp_is_a_failure_of_its_own(world: World) -> None:
    motion = around(2.0)
    q = motion.q.copy()
    q[:, 0] = 2 * RADIUS - 0.03
    trials = simulate(world, Motion(motion.T_world_root, q))
    assert (trials.reason == Reason.PENETRATES).all()
    assert trials.penetration_m[0] == pytest.approx(0.015, abs=1e-3)
    assert np.isnan(trials.displacement_m).all() and not trials.success.any()


def test_a_simulation_that_diverges_is_unstable_never_a_success(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    wild = build_world(gripper(kp=1e13), ball(), Task(DEXGRASPBENCH))
    trials = simulate(wild, around(2.0))
    assert (trials.reason == Reason.HAND_UNSTABLE).all()
    assert not trials.success.any()
    assert not list(tmp_path.iterdir()), "MuJoCo writes its warnings to a file in the current folder"


def test_a_hand_that_diverges_is_a_fault_of_its_model_and_named_by_its_joint() -> None:
    """Servos of light links that nothing damps throw the object, which once was the grasp's fault."""
    made = gripper(kp=20 * KP)
    for geom, joint in zip(made.spec.geoms, made.spec.joints, strict=True):
        geom.mass, joint.damping = 0.002, np.zeros(3)
    trials = simulate(build_world(made, ball(), Task(STRICT)), around(200.0))
    assert (trials.reason == Reason.HAND_UNSTABLE).all() and not trials.success.any()
    assert set(trials.runaways) <= {"left", "right"} and trials.runaways
    assert trials.runaway[0] in reason_lines(trials, STRICT)[0].plain
    # Without that it is the push that makes a simulation diverge.
    pushed = simulate(build_world(gripper(), ball(), Task(replace(STRICT, acceleration=1e13))), around(4.0))
    assert (pushed.reason == Reason.UNSTABLE).all() and pushed.runaways == ()


def test_a_simulation_that_diverges_is_not_set_back_to_its_start() -> None:
    """MuJoCo's autoreset lays the object back to where it lay, which looks like an object that was held."""
    # It leaves the numbers that MuJoCo takes within some steps of the push.
    world = build_world(gripper(), ball(), Task(replace(DEXGRASPBENCH, acceleration=1e13)))
    trials = simulate(world, around(4.0))
    assert (trials.closing_m < 1e-3).all(), "until the push all is well"
    assert (trials.reason == Reason.UNSTABLE).all()
    assert not (trials.displacement_m < 1.0).any()
    closed, times = close(world, around(4.0), Conditions.nominal(world, 1)), []
    push(world, closed, on_step=lambda batch: times.append(batch.time.copy()))
    assert (np.diff(times, axis=0) >= 0).all() and len(times) < DEXGRASPBENCH.steps_per_check


def test_without_memory_for_all_contacts_nothing_is_said_of_a_grasp(world: World) -> None:
    """MuJoCo only warns when contacts no longer fit, and lets things pass through each other: 10 kB were too few."""
    found = set()
    for memory in range(8_000, 24_000, 4_000):
        world.spec.memory = memory
        trials = simulate(replace(world, model=world.spec.compile()), around(4.0))
        found.add(frozenset(trials.reason.ravel().tolist()))
    world.spec.memory = -1
    assert found == {frozenset([Reason.UNSTABLE]), frozenset([Reason.HELD])}


def test_a_bad_grasp_fails_and_harms_no_other(world: World) -> None:
    motion = around(4.0, count=3)
    q, T = motion.q.copy(), motion.T_world_root.copy()
    q[1, 2] = np.nan
    trials = simulate(world, Motion(T, q))
    assert trials.success.tolist() == [True, False, True]
    assert (trials.reason[1] == Reason.NOT_FINITE).all()
    alone = simulate(world, around(4.0))
    np.testing.assert_array_equal(trials.displacement_m[[0]], alone.displacement_m)


def various(count: int, seed: int = 0) -> Motion:
    rng = np.random.default_rng(seed)
    motion = around(0.0, count=count)
    q, T = motion.q.copy(), motion.T_world_root.copy()
    q[:, 2, 0] -= 2 * rng.uniform(0.5, 12.0, count) / KP
    T[..., :3, 3] += rng.uniform(-0.003, 0.003, (count, 1, 3))
    T[:, 2, :3, :3] = exp_so3(rng.uniform(-0.02, 0.02, (count, 3)))
    return Motion(T, q)


def test_a_batch_equals_its_grasps_one_by_one_bit_for_bit_at_any_number_of_threads(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(simulation, "CHUNK_GRASPS", 8)
    world = build_world(gripper(), ball(), Task(STRICT))
    motion = various(8 + 3)
    together = simulate(world, motion, threads=2)
    again = simulate(world, motion, threads=1)
    rows = [0, 7, 8, 10]
    single = Trials.join([simulate(world, motion.select(np.array([row])), threads=1) for row in rows])
    assert 0 < together.success.sum() < len(motion)
    for name in ("reason", "time_s", "displacement_m", "angle_rad", "contacts", "closing_m", "penetration_m"):
        np.testing.assert_array_equal(getattr(together, name), getattr(again, name), err_msg=name)
        np.testing.assert_array_equal(getattr(together, name)[rows], getattr(single, name), err_msg=name)


def test_a_recorded_trial_is_the_same_trial(world: World) -> None:
    motion = around(0.9)
    trials = simulate(world, motion)
    for direction, force in (("+y", [0, PUSH, 0]), ("-x", [-PUSH, 0, 0])):
        replay = record(world, motion, direction, name="ball 0", hand="gripper")
        assert replay is not None
        np.testing.assert_allclose(replay.force, force)
        assert replay.time[0] == 0 and replay.stage[0] == Stage.CLOSE
        np.testing.assert_array_equal(replay.object_pose[0], [0, 0, 0, 1, 0, 0, 0])
        np.testing.assert_array_equal(replay.mocap_pos[0], motion.T_world_root[0, 0, :3, 3])
        opening = motion.q[0, 0, 0]
        np.testing.assert_allclose(replay.qpos[0, world.joints_at], [-opening / 2, opening / 2])
        np.testing.assert_allclose(replay.ctrl[0], [-opening / 2, opening / 2])
        # Every fifth step is kept.
        np.testing.assert_allclose(np.diff(replay.time), 0.02)
        column = trials.directions.index(direction)
        assert replay.reason == Reason(trials.reason[0, column]).label
        moved, turned = replay.displacement()
        pushed = np.flatnonzero(replay.stage == Stage.PUSH)
        # The trial says where it was decided.
        seconds = trials.time_s[0, column]
        at = len(replay) - 1 if np.isnan(seconds) else pushed[0] + round(seconds / 0.02) - 1
        assert moved[at] == trials.displacement_m[0, column]
        assert turned[at] == pytest.approx(trials.angle_rad[0, column], abs=1e-12)
    assert record(world, Motion(motion.T_world_root * np.nan, motion.q), "+x", name="", hand="") is None


def test_without_squeeze_only_what_touches_before_can_hold(world: World) -> None:
    np.testing.assert_array_equal(holds_without_squeeze(world, around(4.0)), [False])
    pressed = around(4.0, grasp=2 * RADIUS - 8.0 / KP)
    np.testing.assert_array_equal(holds_without_squeeze(world, pressed), [True])


def test_noise_is_uniform_in_spheres() -> None:
    """So is then the cube of the length, between 0 and that of the largest; half of the offsets lie on either side."""
    lengths = (0.005, 0.1)
    T = Noise(4000, *lengths).poses(np.array([0]), middle=np.zeros(3))[0]
    for vectors, most in zip((T[:, :3, 3], log_so3(T[:, :3, :3])), lengths, strict=True):
        assert kstest((np.linalg.norm(vectors, axis=1) / most) ** 3, "uniform").pvalue > 0.01
        np.testing.assert_allclose((vectors > 0).mean(axis=0), 0.5, atol=0.03)


def test_an_object_that_is_ejected_while_the_hand_closes_is_not_lost_to_the_push(world: World) -> None:
    # One plate sweeps the ball away.
    motion = around(0.0)
    T, q = motion.T_world_root.copy(), np.full((1, 3, 1), 0.3)
    T[:, 0, 0, 3] -= 0.2
    T[:, 1:, 0, 3] += 0.1
    trials = simulate(world, Motion(T, q))
    assert (trials.reason == Reason.EJECTED_WHILE_CLOSING).all() and not trials.success.any()
    assert trials.closing_m[0] > DEXGRASPBENCH.farthest
    assert np.isnan(trials.time_s).all() and np.isnan(trials.displacement_m).all()


def test_an_object_that_is_turned_while_the_hand_closes_is_not_lost_to_the_push(world: World) -> None:
    # The plates turn about their own axis as they press, and the ball, whose middle stays, with them.
    motion = around(8.0)
    T = motion.T_world_root.copy()
    turn = np.eye(4)
    turn[:3, :3] = exp_so3(np.array([0.6, 0.0, 0.0]))
    T[:, 1], T[:, 2] = T[:, 2], turn @ T[:, 2]
    q = motion.q.copy()
    q[:, 1] = q[:, 2]
    trials = simulate(world, Motion(T, q))
    assert trials.closing_rad[0] == pytest.approx(0.6, abs=0.05) and trials.closing_m[0] < 0.01
    assert (trials.reason == Reason.EJECTED_WHILE_CLOSING).all()


def test_a_failure_says_at_which_check(world: World) -> None:
    # A finger that slips slowly: later than at the first check, and earlier than at the end.
    forces = np.linspace(0.70, 0.86, 17)
    motions = [around(force) for force in forces]
    T, q = (np.concatenate([getattr(motion, name) for motion in motions]) for name in ("T_world_root", "q"))
    trials = simulate(world, Motion(T, q))
    lost = trials.reason == Reason.MOVED
    check = DEXGRASPBENCH.steps_per_check * DEXGRASPBENCH.timestep
    assert (trials.time_s[lost] > 1.5 * check).any(), "none slips slowly"
    np.testing.assert_allclose(trials.time_s[lost] / check, np.round(trials.time_s[lost] / check))
    assert (trials.displacement_m[lost] >= DEXGRASPBENCH.farthest).all()
    assert (trials.peak_m[lost] == trials.displacement_m[lost]).all()
    held = trials.reason == Reason.HELD
    assert np.isnan(trials.time_s[held]).all() and (trials.peak_m[held] >= trials.displacement_m[held]).all()


def test_trials_of_hands_with_other_links_are_joined_by_name(world: World) -> None:
    held = holds(world, 4.0, 0.6)
    other = replace(held, links=("palm", "right plate"), contacts=held.contacts * [True, False])
    joined = Trials.join([held, other])
    assert joined.links == ("left plate", "right plate", "palm") and len(joined) == 2
    np.testing.assert_array_equal(joined.contacts[:, 0], [[True, True, False], [False, False, True]])
