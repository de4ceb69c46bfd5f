"""First-order solvers: the lengths and directions of their steps, their averages, schedule, and joint limits."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from first_order_steps import Given, Known, first_state, one_step
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_se3, inverse
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.first_order import FirstOrder
from grasp_refine.refinement.solvers.iterate import Point, minimise
from grasp_refine.refinement.solvers.status import Status
from refusals import refused
from twists import log_se3

PAPER = Descent(momentum=0.0)
LENGTH = np.array([1e-3] * 3 + [1e-2] * 3 + [2e-2] * 5)
"""Step lengths of the root's translation (m) and rotation (rad), and of the joints (rad)."""

both = pytest.mark.parametrize("solver", [PAPER, Descent(), Adam()], ids=["descent", "momentum", "adam"])


def points(count: int, seed: int = 0) -> tuple[Point, np.ndarray]:
    """Poses, joint values, and gradients of widely different size."""
    rng = np.random.default_rng(seed)
    gradient = rng.normal(size=(count, 11)) * 10.0 ** rng.uniform(-9, 6, (count, 1))
    return Point(exp_se3(rng.normal(size=(count, 6))), rng.normal(size=(count, 5))), gradient


def change(before: Point, after: Point) -> np.ndarray:
    """Body twist and joint values (batch, 11) of a step; the logarithm undoes exp(-(v s_t, w s_r)) to its rounding."""
    return np.concatenate([log_se3(inverse(before.T) @ after.T), after.q - before.q], axis=1)


# lengths and directions


@pytest.mark.parametrize("phase", [0, 1, 2])
def test_descent_moves_translation_rotation_and_joints_each_by_their_own_length(phase: int) -> None:
    """Slides by 0.1 m per radian."""
    point, gradient = points(20)
    unit = np.array([1.0, 0.1, 1.0, 1.0, 0.1])
    after, _ = one_step(PAPER, point, gradient, first_state(PAPER, point, phase), per_radian=unit)
    moved = change(point, after)
    moved[:, 6:] /= unit
    scale = (1.0, *PAPER.factors)[phase]
    for part, length in ((slice(0, 3), 1e-3), (slice(3, 6), 1e-2), (slice(6, None), 2e-2)):
        direction = gradient[:, part] / np.linalg.norm(gradient[:, part], axis=1, keepdims=True)
        np.testing.assert_allclose(moved[:, part], -scale * length * direction, atol=1e-5 * scale * length)


@pytest.mark.parametrize("phase", [0, 1, 2])
def test_first_steps_of_adam_have_their_length_in_every_component_whatever_the_gradient(phase: int) -> None:
    point, gradient = points(6)
    moved = change(point, one_step(Adam(), point, gradient, first_state(Adam(), point, phase))[0])
    np.testing.assert_allclose(moved, -(1.0, *Adam().factors)[phase] * LENGTH * np.sign(gradient), atol=1e-12)


def test_many_steps_of_adam_follow_the_published_recursion() -> None:
    solver, rng = Adam(first=0.8, second=0.95), np.random.default_rng(3)
    point, _ = points(3, 2)
    state = first_state(solver, point)
    m, v = np.zeros((2, 3, 11))
    for t in range(1, 30):
        g = rng.normal(size=(3, 11)) + 0.3
        m, v = 0.8 * m + 0.2 * g, 0.95 * v + 0.05 * g * g
        after, state = one_step(solver, point, g, state)
        expected = -LENGTH * (m / (1 - 0.8**t)) / np.sqrt(v / (1 - 0.95**t))
        np.testing.assert_allclose(change(point, after), expected, atol=1e-12)
        point = after


def test_momentum_averages_gradients_and_not_steps() -> None:
    point, gradient = points(2)
    solver = Descent(momentum=0.75)
    last = np.roll(gradient, 1, axis=1)
    after, state = one_step(solver, point, gradient, replace(first_state(solver, point), memory=last))
    np.testing.assert_allclose(state.memory, 0.75 * last + 0.25 * gradient, rtol=1e-14)
    expected, _ = one_step(PAPER, point, state.memory, first_state(PAPER, point))
    np.testing.assert_allclose(after.T, expected.T, atol=1e-15)
    np.testing.assert_allclose(after.q, expected.q, atol=1e-15)


@both
def test_a_gradient_of_zero_moves_nothing(solver: FirstOrder) -> None:
    point, gradient = points(3)
    gradient[0], gradient[1, :3], gradient[2, 6:] = 0.0, 0.0, 0.0
    after, state = one_step(solver, point, gradient, first_state(solver, point))
    moved = change(point, after)
    assert np.abs(moved[0]).max() < 1e-15 and np.abs(moved[1, :3]).max() < 1e-15 and not moved[2, 6:].any()
    assert np.isfinite(after.T).all() and np.isfinite(state.memory).all()


# members and limits


@both
def test_each_member_has_its_own_phase_and_memory(solver: FirstOrder) -> None:
    """Alone it moves as among others."""
    point, _ = points(4, 4)
    phase, alone = np.array([2, 0, 1, 0]), Point(point.T[2:3], point.q[2:3])
    state, own = first_state(solver, point, phase), first_state(solver, alone, phase[2:3])
    for gradient in np.random.default_rng(5).normal(size=(10, 4, 11)):
        point, state = one_step(solver, point, gradient, state)
        alone, own = one_step(solver, alone, gradient[2:3], own)
    np.testing.assert_allclose(point.q[2:3], alone.q, rtol=1e-14)
    np.testing.assert_allclose(point.T[2:3], alone.T, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(state.memory[2:3], own.memory, rtol=1e-14)


def test_a_joint_that_starts_beyond_a_limit_may_only_come_back() -> None:
    q = np.array([[1.5, -1.5], [1.5, -1.5]])
    point = Point(np.tile(np.eye(4), (2, 1, 1)), q)
    inward = np.concatenate([np.zeros((2, 6)), [[1.0, -1.0], [-1.0, 1.0]]], axis=1)
    after, _ = one_step(PAPER, point, inward, first_state(PAPER, point), -1.0, 1.0)
    np.testing.assert_allclose(after.q[0], [1.5 - 0.02 / np.sqrt(2), -1.5 + 0.02 / np.sqrt(2)])
    np.testing.assert_array_equal(after.q[1], q[1])


# schedule


def test_the_schedule_shrinks_at_its_shares() -> None:
    solver = Descent(iterations=200, shares=(0.5, 0.8), factors=(0.1, 0.01))
    iterations = np.array([0, 99, 100, 159, 160, 199])
    np.testing.assert_array_equal(solver.first_phase(iterations), [0, 0, 1, 1, 2, 2])
    assert not Descent(shares=(), factors=()).first_phase(iterations).any()


@dataclass(frozen=True, eq=False)
class Evaluated(Known):
    loss: np.ndarray
    num_queries: np.ndarray


class Slope(Given):
    """The only joint value as the loss: it falls as fast everywhere."""

    width, restarts = 8, False

    def evaluate(self, member: np.ndarray, point: Point, previous: Evaluated | None) -> Evaluated:
        gradient = np.concatenate([np.zeros((len(member), 6)), np.ones((len(member), 1))], axis=1)
        return Evaluated(gradient, point.q[:, 0], np.ones(len(member), dtype=np.int64))


def test_steps_shrink_after_their_shares_of_the_iterations() -> None:
    """The first iteration evaluates the start; the step of the fifth, still a whole one, is evaluated by the sixth."""
    solver, path = Descent(iterations=10, shares=(0.5, 0.8), factors=(0.1, 0.01), progress=0.0), []
    joint = (torch.tensor([value], dtype=torch.float64) for value in (-100.0, 100.0, 1.0))
    start = Point(np.eye(4)[None], np.array([[5.0]]))
    minimise(Slope(*joint), start, solver, 0.0, on_iteration=lambda member, point, loss: path.append(point.q[0, 0]))
    np.testing.assert_allclose(-np.diff(path) / solver.step_joints, [1.0] * 5 + [0.1] * 3 + [0.01], rtol=1e-9)


class Level(Slope):
    """Losses that never fall."""

    def evaluate(self, member: np.ndarray, point: Point, previous: Evaluated | None) -> Evaluated:
        return replace(super().evaluate(member, point, previous), loss=np.ones(len(member)))


def test_where_losses_no_longer_fall_steps_shrink_and_the_last_ones_end_it() -> None:
    """Three steps of each length, the patience, before half of the iterations are over."""
    solver, path = Descent(iterations=100, patience=3, factors=(0.1, 0.01)), []
    joint = (torch.tensor([value], dtype=torch.float64) for value in (-100.0, 100.0, 1.0))
    start = Point(np.eye(4)[None], np.array([[5.0]]))
    found = minimise(
        Level(*joint), start, solver, 0.0, on_iteration=lambda member, point, loss: path.append(point.q[0, 0])
    )
    assert found.status[0] == Status.STALLED and found.iterations[0] == 1 + 3 * 3
    np.testing.assert_allclose(-np.diff(path) / solver.step_joints, [1.0] * 3 + [0.1] * 3 + [0.01] * 3, rtol=1e-9)


@pytest.mark.parametrize(
    ("kind", "settings", "named"),
    [
        (Descent, {"momentum": -0.1}, ("momentum", "-0.1")),
        (Descent, {"momentum": 1.0}, ("momentum", "1")),
        (Adam, {"first": -0.1}, ("first", "second", "-0.1")),
        (Adam, {"second": 1.0}, ("first", "second", "1")),
        (Adam, {"shares": (0.5,)}, ("adam", "shares", "factors", "1 and 2")),
        (Descent, {"shares": (0.1, 0.2, 0.3)}, ("descent", "shares", "factors", "3 and 2")),
    ],
)
def test_settings_that_cannot_work_are_refused(
    kind: type[FirstOrder], settings: dict[str, object], named: tuple[str, ...]
) -> None:
    with refused(GraspRefineError, *named):
        kind(**settings)
