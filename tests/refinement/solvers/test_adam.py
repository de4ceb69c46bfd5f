"""Adam on root pose and joint values: the published recursion, its step lengths, limits."""

import numpy as np
import pytest
import torch

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_se3, inverse, log_se3
from grasp_refine.refinement.solvers.adam import Adam
from refusals import refused

FREE = torch.full((5,), torch.inf, dtype=torch.float64)
LENGTH = torch.tensor([1e-3] * 3 + [1e-2] * 3 + [2e-2] * 5, dtype=torch.float64)
"""Step lengths of the root's translation (m) and rotation (rad), and of the joints (rad)."""


def state(count: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(seed)
    return torch.from_numpy(exp_se3(rng.normal(size=(count, 6)))), torch.from_numpy(rng.normal(size=(count, 5)))


def change(T: torch.Tensor, q: torch.Tensor, T_after: torch.Tensor, q_after: torch.Tensor) -> np.ndarray:
    """Body twist and joint values (batch, 11) of a step."""
    return np.concatenate([log_se3((inverse(T) @ T_after).numpy()), (q_after - q).numpy()], axis=1)


@pytest.mark.parametrize("stage", [0, 1, 2])
def test_first_steps_have_their_length_in_every_component_whatever_the_gradient(stage: int) -> None:
    solver = Adam()
    T, q = state(6)
    rng = np.random.default_rng(1)
    gradient = torch.from_numpy(rng.normal(size=(6, 11)) * 10.0 ** rng.uniform(-9, 6, (6, 1)))
    T_after, q_after, _ = solver.step(T, q, gradient, solver.memory(gradient), torch.full((6,), stage), -FREE, FREE)
    scale = (1.0, *solver.factors)[stage]
    # exp(-(v s_t, w s_r)) is undone by the logarithm, to its rounding.
    np.testing.assert_allclose(
        change(T, q, T_after, q_after), -scale * LENGTH.numpy() * np.sign(gradient.numpy()), atol=1e-12
    )


def test_many_steps_follow_the_published_recursion() -> None:
    solver = Adam(first=0.8, second=0.95)
    T, q = state(3, 2)
    rng = np.random.default_rng(3)
    m, v = np.zeros((2, 3, 11))
    memory = solver.memory(torch.zeros(3, 11, dtype=torch.float64))
    for t in range(1, 30):
        g = rng.normal(size=(3, 11)) + 0.3
        m, v = 0.8 * m + 0.2 * g, 0.95 * v + 0.05 * g * g
        expected = -LENGTH.numpy() * (m / (1 - 0.8**t)) / np.sqrt(v / (1 - 0.95**t))
        T_after, q_after, memory = solver.step(T, q, torch.from_numpy(g), memory, torch.zeros(3).long(), -FREE, FREE)
        np.testing.assert_allclose(change(T, q, T_after, q_after), expected, atol=1e-12)
        T, q = T_after, q_after


def test_a_gradient_of_zero_moves_nothing() -> None:
    solver = Adam()
    T, q = state(2)
    zero = torch.zeros(2, 11, dtype=torch.float64)
    T_after, q_after, memory = solver.step(T, q, zero, solver.memory(zero), torch.zeros(2).long(), -FREE, FREE)
    torch.testing.assert_close(T_after, T, rtol=0, atol=1e-15)
    assert torch.equal(q_after, q) and torch.isfinite(memory).all()


def test_members_remember_on_their_own() -> None:
    """A member that joined later, or alone, moves the same."""
    solver = Adam()
    T, q = state(4, 4)
    rng = np.random.default_rng(5)
    gradients = torch.from_numpy(rng.normal(size=(10, 4, 11)))
    together, alone = (T, q, solver.memory(gradients[0])), (T[2:3], q[2:3], solver.memory(gradients[0, 2:3]))
    for g in gradients:
        together = solver.step(*together[:2], g, together[2], torch.zeros(4).long(), -FREE, FREE)
        alone = solver.step(*alone[:2], g[2:3], alone[2], torch.zeros(1).long(), -FREE, FREE)
    for one, every in zip(alone, together, strict=True):
        torch.testing.assert_close(one, every[2:3], rtol=1e-14, atol=1e-15)


def test_joints_never_leave_their_limits() -> None:
    solver = Adam(step_joints=0.3)
    lower, upper = -torch.ones(5).double(), torch.tensor([0.5, 1.0, 1.0, 1.0, torch.inf]).double()
    T, q = torch.eye(4).double().expand(8, 4, 4), torch.zeros(8, 5).double()
    rng = np.random.default_rng(6)
    memory = solver.memory(torch.zeros(8, 11).double())
    for _ in range(100):
        push = torch.from_numpy(rng.normal(size=(8, 11)) + rng.choice([-3, 3], (8, 1)))
        T, q, memory = solver.step(T, q, push, memory, torch.zeros(8).long(), lower, upper)
        assert (q >= lower).all() and (q <= upper).all()
    assert (q == lower).any() and (q[:, :4] == upper[:4]).any()


def test_steps_lower_a_simple_loss() -> None:
    """The squared distance of a frame's origin to a point, and the squares of the joint values."""
    solver = Adam(step_translation=0.02)
    T, q = state(4, 7)
    target = torch.tensor([0.3, -0.1, 0.2], dtype=torch.float64)
    memory = solver.memory(torch.zeros(4, 11).double())
    first = (T[:, :3, 3] - target).square().sum(1) + q.square().sum(1)
    for _ in range(300):
        pull = (T[:, :3, :3].mT @ (T[:, :3, 3] - target)[..., None])[..., 0]
        gradient = torch.cat([pull, torch.zeros(4, 3), q], dim=1)
        T, q, memory = solver.step(T, q, gradient, memory, torch.zeros(4).long(), -FREE, FREE)
    assert ((T[:, :3, 3] - target).square().sum(1) + q.square().sum(1) < 1e-2 * first).all()


@pytest.mark.parametrize("which", ["first", "second"])
@pytest.mark.parametrize("value", [-0.1, 1.0])
def test_averages_that_never_forget_are_refused(which: str, value: float) -> None:
    with refused(GraspRefineError, "first", "second", "0", "1", f"{value:g}"):
        Adam(**{which: value})


def test_shares_and_factors_belong_together() -> None:
    with refused(GraspRefineError, "adam", "shares", "factors", "1 and 2"):
        Adam(shares=(0.5,))
