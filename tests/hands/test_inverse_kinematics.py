"""Inverse kinematics of arms: poses that are reached are reached exactly, others are said to be out of reach."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.core.errors import GraspRefineError, HandError
from grasp_refine.core.se3 import distances, exp_so3, log_so3, transform
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.hands.inverse_kinematics import GOOD_DEXTERITY, ROTATION_M_PER_RAD, ArmKinematics
from grasp_refine.hands.mount import mount
from grasp_refine.hands.self_collision import self_penetration, touching_pairs

T_BASE = transform(exp_so3(np.array([0.1, -0.2, 0.5])), np.array([0.3, -0.4, 0.1]))


@pytest.fixture(scope="module")
def whole() -> Hand:
    """Return a gripper on an arm."""
    return mount(load_hand("ur5e", candidates=32), load_hand("franka_hand", candidates=32))


@pytest.fixture(scope="module")
def kinematics(whole: Hand) -> ArmKinematics:
    """Return its kinematics."""
    return ArmKinematics(whole)


def reachable(whole: Hand, count: int, seed: int = 0) -> np.ndarray:
    """Return joint values (count, n) of the arm within half a turn, the hand at rest."""
    q = np.tile(whole.rest, (count, 1))
    arm = whole.arm_joints
    q[:, arm] = np.random.default_rng(seed).uniform(-np.pi, np.pi, (count, int(arm.sum())))
    return np.clip(q, whole.lower, whole.upper)


def test_poses_of_the_arm_are_found_again_to_a_micrometre(whole: Hand, kinematics: ArmKinematics) -> None:
    """Every pose that the arm has without self-collision is reached, by joint values within their limits."""
    count = 40
    q, T_base = reachable(whole, count), np.tile(T_BASE, (count, 1, 1))
    q = q[self_penetration(whole, touching_pairs(whole), q) == 0.0]
    T = kinematics.palm(T_base[: len(q)], q)
    found = kinematics.solve(T_BASE, q[:, ~whole.arm_joints], T)
    assert len(q) > 20 and found.reached.mean() > 0.95
    at = found.reached
    moved, turned = distances(T[at], kinematics.palm(T_base[: at.sum()], found.best[at]))
    assert moved.max() < 1e-6 and turned.max() < 1e-6
    assert (found.best[at] >= whole.lower).all() and (found.best[at] <= whole.upper).all()
    assert (self_penetration(whole, touching_pairs(whole), found.best[at]) == 0.0).all()
    np.testing.assert_array_equal(found.best[:, ~whole.arm_joints], q[:, ~whole.arm_joints])


def test_solutions_differ(whole: Hand, kinematics: ArmKinematics) -> None:
    """A wrist of this kind has up to eight ways to a pose; each is there once."""
    q = np.tile(whole.rest, (1, 1))
    T = kinematics.palm(T_BASE[None], q)
    found = kinematics.solve(T_BASE, q[:, ~whole.arm_joints], T, starts=64)
    ways = found.q[0][np.isfinite(found.dexterity[0])][:, whole.arm_joints]
    assert 4 <= len(ways) <= 8
    turned = np.abs((ways[:, None] - ways + np.pi) % (2.0 * np.pi) - np.pi).max(axis=-1)
    assert (turned[~np.eye(len(ways), dtype=bool)] > 0.01).all()


def test_solutions_are_ranked_free_ones_first_then_far_from_singular_then_near_rest(
    whole: Hand, kinematics: ArmKinematics
) -> None:
    q = np.tile(whole.rest, (6, 1))
    q[:, 2] = np.linspace(0.02, 0.8, 6)  # an elbow that is nearly straight
    found = kinematics.solve(T_BASE, q[:, ~whole.arm_joints], kinematics.palm(np.tile(T_BASE, (6, 1, 1)), q))
    poor = np.maximum(GOOD_DEXTERITY - found.dexterity, 0.0)
    away = np.abs(found.q - whole.rest).max(axis=2)
    for row in range(6):
        known = np.isfinite(poor[row])
        assert (np.diff(found.free[row, known].astype(int)) <= 0).all()
        for group in (True, False):
            rows = known & (found.free[row] == group)
            assert (np.diff(1e4 * poor[row, rows] + away[row, rows]) >= -1e-6).all()
    assert ((poor > 1e-3) & found.free).sum(axis=1).max() >= 2 and (poor == 0.0).any()


def test_poses_beyond_the_arm_are_out_of_reach(whole: Hand, kinematics: ArmKinematics) -> None:
    """Their arms are NaN, and the fingers are as they were; neighbours in the batch do not matter."""
    q = np.tile(whole.rest, (3, 1))
    T = kinematics.palm(np.tile(T_BASE, (3, 1, 1)), q)
    T[1, :3, 3] += [2.0, 0.0, 0.0]
    T[2] = np.nan
    found = kinematics.solve(T_BASE, q[:, ~whole.arm_joints], T)
    assert found.reached.tolist() == [True, False, False]
    assert np.isnan(found.best[1:][:, whole.arm_joints]).all()
    np.testing.assert_array_equal(found.best[:, ~whole.arm_joints], q[:, ~whole.arm_joints])
    alone = kinematics.solve(T_BASE, q[:1, ~whole.arm_joints], T[:1])
    np.testing.assert_array_equal(alone.best[0], found.best[0])


def test_limits_hold_where_the_only_way_is_beyond_them(whole: Hand) -> None:
    """A pose that needs a joint beyond its limit is out of reach once the limit is narrow."""
    q = np.tile(whole.rest, (1, 1))
    T = ArmKinematics(whole).palm(np.eye(4)[None], q)
    upper = whole.upper.copy()
    upper[0] = -1.0
    lower = whole.lower.copy()
    lower[0] = -1.5
    rest = whole.rest.copy()
    rest[0] = -1.2
    narrow = ArmKinematics(replace(whole, lower=lower, upper=upper, rest=rest))
    assert not narrow.solve(np.eye(4), q[:, ~whole.arm_joints], T).reached[0]
    values, reached = narrow.follow(np.eye(4)[None], np.where(whole.arm_joints, rest, q), T)
    assert not reached[0] and -1.5 <= values[0, 0] <= -1.0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_joints_leave_limits_at_which_they_start(whole: Hand, side: float) -> None:
    """All start at a limit; the pose is inside, or one joint must stay at its limit with the least error left."""
    arm, rest = whole.arm_joints, whole.rest
    near, far = (np.where(arm, rest + side * step, rest) for step in (0.0, 0.5))
    bounds = {"lower": np.where(arm, np.minimum(near, far), whole.lower),
              "upper": np.where(arm, np.maximum(near, far), whole.upper)}  # fmt: skip
    kinematics = ArmKinematics(replace(whole, **bounds))
    start, wanted = near[None], np.where(arm, rest + side * np.linspace(0.1, 0.3, len(rest)), rest)[None]
    T_base = T_BASE[None]
    found, reached = kinematics.follow(T_base, start, kinematics.palm(T_base, wanted))
    assert reached.all()
    np.testing.assert_allclose(found, wanted, atol=1e-5)
    beyond = wanted.copy()
    beyond[0, 0] = rest[0] - side * 0.02
    T = kinematics.palm(T_base, beyond)
    found, reached = kinematics.follow(T_base, start, T, iterations=300)
    assert not reached[0] and found[0, 0] == near[0]
    at, J = kinematics.jacobian(T_base, found)
    error = np.concatenate([T[0, :3, 3] - at[0, :3, 3], log_so3(T[0, :3, :3] @ at[0, :3, :3].T)])
    pull = J[0].T @ (error * np.repeat([1.0, ROTATION_M_PER_RAD**2], 3))
    assert side * pull[0] < -1e-4 and np.abs(pull[1:]).max() < 1e-6


def test_jacobian_is_the_finite_difference_of_the_palm(whole: Hand, kinematics: ArmKinematics) -> None:
    """Velocity of the palm's origin, and its turn, by central differences; its least singular value is `dexterity`."""
    q = reachable(whole, 1, seed=4)
    T_base = T_BASE[None]
    _, J = kinematics.jacobian(T_base, q)
    h, columns = 1e-6, []
    for joint in kinematics.joints:
        step = np.zeros_like(q)
        step[:, joint] = h
        before, after = (kinematics.palm(T_base, q + sign * step)[0] for sign in (-1, 1))
        turn = log_so3(after[:3, :3] @ before[:3, :3].T)
        columns.append(np.concatenate([after[:3, 3] - before[:3, 3], turn]) / (2 * h))
    np.testing.assert_allclose(J[0], np.array(columns).T, atol=1e-8)
    scaled = np.array(columns).T * np.repeat([1.0, ROTATION_M_PER_RAD], 3)[:, None]
    expected = np.linalg.svd(scaled, compute_uv=False)[-1]
    np.testing.assert_allclose(kinematics.dexterity(T_base, q), [expected], atol=1e-8)


def test_straight_elbow_is_singular(whole: Hand, kinematics: ArmKinematics) -> None:
    """There the palm cannot move along the arm; bent, it can."""
    straight = np.tile(whole.rest, (1, 1))
    straight[0, 2] = 0.0
    dexterity = kinematics.dexterity(np.tile(T_BASE, (2, 1, 1)), np.concatenate([straight, whole.rest[None]]))
    assert dexterity[0] < 1e-9 and dexterity[1] > 0.01


def test_shortfall_is_how_far_the_palm_stays_away(whole: Hand, kinematics: ArmKinematics) -> None:
    """Nothing at poses of the arm; 3 m out, what is left of that beyond its longest reach."""
    q = reachable(whole, 3)
    T_base = np.tile(T_BASE, (3, 1, 1))
    T, hand = kinematics.palm(T_base, q), q[:, ~whole.arm_joints]
    assert kinematics.shortfall(T_base, hand, T).max() < 1e-6
    T[:, :3, 3] = T_BASE[:3, 3] + [3.0, 0.0, 0.0]
    away = kinematics.shortfall(T_base, hand, T)
    drawn = kinematics.palm(np.tile(T_BASE, (4000, 1, 1)), reachable(whole, 4000))[:, :3, 3]
    reach = np.linalg.norm(drawn - T_BASE[:3, 3], axis=1).max()
    assert (away[:, 0] > 3.0 - reach - 0.15).all() and (away[:, 0] < 3.0 - 0.5 * reach).all()


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda whole: ArmKinematics(load_hand("franka_hand", candidates=32)), HandError),
        (lambda whole: ArmKinematics(whole).solve(np.eye(4), np.zeros((1, 9)), np.eye(4)[None]), GraspRefineError),
    ],
)
def test_wrong_inputs_are_refused(whole: Hand, call: Callable, error: type[Exception]) -> None:
    """A hand without an arm, and joint values of another number."""
    with pytest.raises(error):
        call(whole)
