"""Margins of a gripper whose forces are known in closed form."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from mujoco.batch import Batch

from grasp_refine.closing.motion import Motion
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.objects.object import Object
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.tabletop import TABLETOP
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.margins.draws import draw
from grasp_refine.validation.margins.factors import JOINT, PUSH, Factors
from grasp_refine.validation.margins.limits import FORCE_RANGE_N, FRICTION_RANGE, STEPS, TORQUE_RANGE_NM, limits
from grasp_refine.validation.margins.margins import ALONE_SHARE, NO_FACTOR, Margins, Worlds, margins
from grasp_refine.validation.simulation import Closed, close, push, simulate
from grasp_refine.validation.trials import Reason
from gripper import KP, RADIUS, around, ball, gripper, two_balls

WEIGHT = DEXGRASPBENCH.mass * DEXGRASPBENCH.acceleration
ACROSS = np.array([0.0, 1.0, 0.0])
ALONE = (PUSH, "pose", "friction", "softness", "servos", "thickness")


@pytest.fixture(scope="module")
def worlds() -> Worlds:
    return Worlds.of(gripper(), ball(), Task(DEXGRASPBENCH))


def pressing(*forces: float) -> Motion:
    """A grasp for each force of the plates."""
    parts = [around(force) for force in forces]
    return Motion(np.concatenate([p.T_world_root for p in parts]), np.concatenate([p.q for p in parts]))


def normal_force(worlds: Worlds, motion: Motion) -> np.ndarray:
    """Force (N,) of each plate after closing, by the law of its servo."""
    closed = close(worlds.usual, motion, Conditions.nominal(worlds.usual, len(motion)))
    opening = np.abs(plates(worlds.usual, closed)).sum(axis=1)
    return KP * (opening - motion.q[:, 2, 0]) / 2


def plates(world: World, closed: Closed) -> np.ndarray:
    """Positions (N, 2) of the plates after closing."""
    batch = Batch(world.model, len(closed.state), 1)
    batch.state[:] = closed.state
    return batch.qpos[:, world.joints_at]


def test_the_share_under_friction_alone_is_that_of_the_frictions_that_carry_the_weight(worlds: Worlds) -> None:
    draws = replace(draw(Factors(), 32 * ALONE_SHARE), direction=np.tile(ACROSS, (32 * ALONE_SHARE, 1)))
    motion = pressing(0.8, 1.2, 3.5)
    found = margins(worlds, motion, draws, trials=("friction",), with_limits=False)
    # Friction is uniform from 0.2 to 1, and both plates carry the weight up to friction x normal force.
    least = WEIGHT / (2 * normal_force(worlds, motion))
    expected = np.clip((1.0 - least) / 0.8, 0.0, 1.0)
    assert 0.2 < expected[0] < 0.6 < expected[1] < 0.9 and expected[2] == 1.0
    share = found.held["friction"].mean(axis=1)
    assert share == pytest.approx(expected, abs=0.1)
    low, high = found.interval[:, 0].T
    assert ((low <= expected) & (expected <= high)).all()


def test_each_draw_holds_where_friction_carries_the_weight_across(worlds: Worlds) -> None:
    draws, motion = draw(Factors(), 32 * ALONE_SHARE), pressing(1.6)
    found = margins(worlds, motion, draws, trials=(PUSH, "friction", "mass"), with_limits=False)
    draws = draws.select(np.arange(32))
    along = np.abs(draws.direction[:, 0])
    across, normal = np.sqrt(1 - along**2), normal_force(worlds, motion)
    for factor, friction, mass in (
        (PUSH, np.full(32, DEXGRASPBENCH.friction), np.full(32, DEXGRASPBENCH.mass)),
        ("friction", draws.friction, np.full(32, DEXGRASPBENCH.mass)),
        ("mass", np.full(32, DEXGRASPBENCH.friction), draws.mass),
    ):
        weight = mass * DEXGRASPBENCH.acceleration
        # A ball that does not roll loads both plates alike across, up to the friction of the one that presses less.
        share = (weight * across / 2) / (friction * np.maximum(normal - weight * along / 2, 1e-9))
        clear = (share < 0.8) | (share > 1.2)
        assert clear.sum() > 15, factor
        np.testing.assert_array_equal(found.held[factor][0, clear], share[clear] < 1)


def test_a_factor_that_cannot_matter_costs_nothing(worlds: Worlds) -> None:
    found = margins(worlds, pressing(8.0), draw(Factors(), 8 * ALONE_SHARE), trials=ALONE, with_limits=False)
    # The plates are wider than any shift of a ball, and press eight times as firmly as the weight needs.
    for factor in ALONE:
        assert found.held[factor].all(), factor
    narrow = Factors(0.0, 0.0, (0.6, 0.6), (0.1, 0.1), (1.0, 1.0), 0.0, (1.0, 1.0), (1.0, 1.0), (0.0, 0.0))
    same = margins(worlds, pressing(0.9), draw(narrow, 16), with_limits=False)
    for trial in same.trials:
        np.testing.assert_array_equal(same.held[trial][:, :4], same.held[PUSH])
    assert same.worst.tolist() == [PUSH] and 0 < same.held[JOINT].mean() < 1


@pytest.mark.slow
def test_trials_depend_neither_on_other_grasps_nor_on_threads_nor_on_other_draws(worlds: Worlds) -> None:
    draws, motion, trials = draw(Factors(), 8), pressing(1.0, 1.5), (JOINT, "friction")
    together = margins(worlds, motion, draws, trials=trials, threads=2)
    apart = [margins(worlds, motion.select(np.array([row])), draws, trials=trials, threads=1) for row in (1, 0)]
    joined = Margins.join(apart)
    for name in trials:
        np.testing.assert_array_equal(joined.held[name], together.held[name][::-1])
    assert together.limits is not None and joined.limits is not None
    for name in ("friction", "force", "torque"):
        np.testing.assert_array_equal(getattr(joined.limits, name), getattr(together.limits, name)[::-1])
    fewer = margins(worlds, motion, draw(Factors(), 4), trials=trials, with_limits=False)
    np.testing.assert_array_equal(fewer.held[JOINT], together.held[JOINT][:, :4])
    np.testing.assert_array_equal(fewer.held["friction"], together.held["friction"][:, :1])
    assert together.held["friction"].shape == (2, 8 // ALONE_SHARE) and together.draws == 8
    assert joined.trials == trials and len(joined) == 2
    assert joined.select(np.array([1])).worst_of(np.ones(2)) == NO_FACTOR


def test_a_grasp_that_is_no_grasp_is_lost_in_every_draw(worlds: Worlds) -> None:
    motion = around(4.0, count=2)
    motion.q[1, 1] = np.nan
    found = margins(worlds, motion, draw(Factors(), 4), trials=(JOINT,))
    assert not found.held[JOINT][1].any() and found.held[JOINT][0].any()
    assert found.limits is not None
    assert np.isnan(found.limits.friction[1]) and found.limits.force[1] == found.limits.torque[1] == 0.0


def test_an_object_that_closing_loses_is_lost(worlds: Worlds) -> None:
    # Shifted by 10 cm, the ball is not between the plates, where it would lie still without being pushed.
    far = replace(draw(Factors(), 8), shift=np.tile([0.0, 0.1, 0.0], (8, 1)))
    found = margins(worlds, pressing(4.0), far, trials=(PUSH, "pose"), with_limits=False)
    assert not found.held["pose"].any() and found.held[PUSH].all()
    assert found.worst.tolist() == ["pose"]


def test_the_other_model_is_used_in_its_draws_alone(worlds: Worlds) -> None:
    weak = Worlds.of(worlds.usual.hand, ball(), Task(DEXGRASPBENCH), gripper(kp=0.05 * KP))
    draws = draw(Factors(), 8 * ALONE_SHARE)
    found = margins(weak, pressing(4.0), draws, trials=(PUSH, "model"), with_limits=False)
    np.testing.assert_array_equal(found.held["model"][0], ~draws.other_model[:8])
    assert found.held[PUSH].all() and found.worst.tolist() == ["model"]
    assert "model" not in worlds.trials


def test_limits_are_as_in_coulomb_and_the_next_step_is_lost(worlds: Worlds) -> None:
    motion = pressing(1.0, 4.0)
    found, nominal = limits(worlds.usual, motion), Conditions.nominal(worlds.usual, 2)
    closed, normal = close(worlds.usual, motion, nominal), normal_force(worlds, motion)
    of_friction, of_force, of_torque = (
        (high / low) ** (0.5**STEPS) for low, high in (FRICTION_RANGE, FORCE_RANGE_N, TORQUE_RANGE_NM)
    )
    # Near its limit MuJoCo's friction creeps, by less than 5 cm in 2 s within some percent of it.
    ratio = found.friction / (WEIGHT / (2 * normal))
    assert (ratio > 0.9).all() and (ratio < of_friction * 1.05).all()
    ratio = found.force / (2 * DEXGRASPBENCH.friction * normal)
    assert (ratio < 1.1).all() and (ratio > 0.95 / of_force).all()
    assert simulate(worlds.usual, motion, replace(nominal, friction=found.friction)).success.all()
    assert not simulate(worlds.usual, motion, replace(nominal, friction=found.friction / of_friction)).success.any()
    for first, values, step in ((0, found.force, of_force), (3, found.torque, of_torque)):
        wrench = np.zeros((2, 6, 6))
        wrench[:, np.arange(6), first + np.arange(6) // 2] = values[:, None] * [1, -1, 1, -1, 1, -1]
        for factor, held in ((1.0, True), (step, False)):
            pushed = replace(closed, conditions=replace(nominal, wrench=factor * wrench))
            assert (push(worlds.usual, pushed).success == held).all()


@pytest.mark.parametrize("make", [ball, two_balls])
@pytest.mark.parametrize("by", [-0.001, 0.001])
def test_a_thicker_object_is_pressed_as_one_of_larger_pieces(make: Callable[[], Object], by: float) -> None:
    obj, motion = make(), around(4.0)
    pieces = tuple(replace(piece, radius=piece.radius + by) for piece in obj.body.pieces)
    exact = build_world(gripper(), obj.with_body(replace(obj.body, pieces=pieces)), Task(DEXGRASPBENCH))
    world = build_world(gripper(), obj, Task(DEXGRASPBENCH))
    if make is two_balls:
        motion.q[0, 1:] -= 2 * (RADIUS - 0.02)
    found = []
    for each, thickness in ((exact, None), (world, np.array([by]))):
        closed = close(each, motion, replace(Conditions.nominal(each, 1), thickness=thickness))
        assert closed.reason[0] == Reason.HELD
        found.append(plates(each, closed))
    np.testing.assert_allclose(found[1], found[0], atol=2e-6)


def test_trials_that_are_none_are_refused(worlds: Worlds) -> None:
    for trials in (("gravity",), ("model",), ()):
        with pytest.raises(GraspRefineError, match="friction"):
            margins(worlds, pressing(1.0), draw(Factors(), 2), trials=trials)


def test_protocols_that_lift_are_refused() -> None:
    with pytest.raises(GraspRefineError, match="tabletop"):
        Worlds.of(gripper(), ball(), Task(TABLETOP))
