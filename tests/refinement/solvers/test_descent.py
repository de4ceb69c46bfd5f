"""Normalised descent: the length of its steps, their direction, its schedule, and joint limits."""

import numpy as np
import pytest
import torch

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_se3, inverse, log_se3
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.status import Status
from refusals import refused

PAPER = Descent(momentum=0.0)
FREE = torch.full((5,), torch.inf, dtype=torch.float64)


def state(count: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Poses, joint values and gradients of widely different size."""
    rng = np.random.default_rng(seed)
    gradient = rng.normal(size=(count, 11)) * 10.0 ** rng.uniform(-12, 6, (count, 1))
    return tuple(map(torch.from_numpy, (exp_se3(rng.normal(size=(count, 6))), rng.normal(size=(count, 5)), gradient)))


def step(
    solver: Descent, T: torch.Tensor, q: torch.Tensor, gradient: torch.Tensor, stage: int = 0
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    stages = torch.full((len(q),), stage)
    return solver.step(T, q, gradient, torch.zeros_like(gradient), stages, -FREE, FREE)


@pytest.mark.parametrize("stage", [0, 1, 2])
def test_translation_rotation_and_joints_each_move_by_their_own_length(stage: int) -> None:
    T, q, gradient = state(20)
    moved, joints, _ = step(PAPER, T, q, gradient, stage)
    scale = (1.0, *PAPER.factors)[stage]
    body = log_se3((inverse(T) @ moved).numpy())
    np.testing.assert_allclose(np.linalg.norm(body[:, 3:], axis=1), 1e-2 * scale, rtol=1e-6)
    # exp(-(v s_t, w s_r)): the linear part of the logarithm is that of the twist.
    np.testing.assert_allclose(np.linalg.norm(body[:, :3], axis=1), 1e-3 * scale, rtol=1e-6)
    np.testing.assert_allclose((joints - q).norm(dim=1), 2e-2 * scale, rtol=1e-9)
    # Against the gradient, in the body's frame.
    for part, found in ((gradient[:, :3], body[:, :3]), (gradient[:, 3:6], body[:, 3:]), (gradient[:, 6:], joints - q)):
        part, found = part.numpy(), np.asarray(found)
        cosine = (part * found).sum(1) / np.linalg.norm(part, axis=1) / np.linalg.norm(found, axis=1)
        np.testing.assert_allclose(cosine, -1.0, atol=1e-9)


def test_a_zero_gradient_moves_nothing_and_each_part_on_its_own() -> None:
    T, q, gradient = state(3)
    gradient[0] = 0.0
    gradient[1, :3] = 0.0
    gradient[2, 6:] = 0.0
    moved, joints, _ = step(PAPER, T, q, gradient)
    torch.testing.assert_close(moved[0], T[0], rtol=0, atol=1e-15)
    assert torch.equal(joints[0], q[0]) and torch.equal(joints[2], q[2])
    assert log_se3(inverse(T) @ moved)[1, :3].norm() < 1e-15
    assert torch.isfinite(moved).all() and torch.isfinite(joints).all()


def test_steps_lower_a_simple_loss() -> None:
    """The squared distance of a frame to another one, whose gradient is known."""
    T, q, _ = state(4, seed=1)
    target = torch.tensor([0.3, -0.1, 0.2], dtype=torch.float64)
    start = (T[:, :3, 3] - target).norm(dim=1)
    for _ in range(100):
        pull = (T[:, :3, :3].mT @ (T[:, :3, 3] - target)[..., None])[..., 0]
        gradient = torch.cat([pull, torch.zeros(4, 3), q], dim=1)
        T, q, _ = step(PAPER, T, q, gradient)
    torch.testing.assert_close(start - (T[:, :3, 3] - target).norm(dim=1), torch.full((4,), 0.1).double())


def test_each_grasp_has_a_stage_of_its_own() -> None:
    T, q, gradient = state(3)
    zero = torch.zeros_like(gradient)
    _, mixed, _ = PAPER.step(T, q, gradient, zero, torch.tensor([2, 0, 1]), -FREE, FREE)
    for item, stage in enumerate((2, 0, 1)):
        _, alone, _ = step(PAPER, T, q, gradient, stage)
        assert torch.equal(mixed[item], alone[item])


def test_momentum_averages_gradients_and_not_steps() -> None:
    T, q, gradient = state(2)
    solver = Descent(momentum=0.75)
    other = torch.roll(gradient, 1, dims=1)
    stage = torch.zeros(2, dtype=torch.int64)
    _, _, average = solver.step(T, q, gradient, other, stage, -FREE, FREE)
    torch.testing.assert_close(average, 0.75 * other + 0.25 * gradient)
    expected = step(PAPER, T, q, average)
    found = solver.step(T, q, gradient, other, stage, -FREE, FREE)
    torch.testing.assert_close(found[0], expected[0])
    torch.testing.assert_close(found[1], expected[1])


def test_joints_never_leave_their_limits() -> None:
    lower, upper = -torch.ones(5).double(), torch.tensor([0.5, 1.0, 1.0, 1.0, torch.inf]).double()
    rng = np.random.default_rng(2)
    q = torch.from_numpy(rng.uniform(-1, 0.5, (8, 5)))
    T = torch.eye(4, dtype=torch.float64).expand(8, 4, 4)
    average = torch.zeros(8, 11, dtype=torch.float64)
    for _ in range(300):
        push = torch.from_numpy(rng.normal(size=(8, 11)) + rng.choice([-3, 3], (8, 1)))
        T, q, average = Descent(step_joints=0.3).step(T, q, push, average, torch.zeros(8).long(), lower, upper)
        assert (q >= lower).all() and (q <= upper).all()
    assert (q == lower).any() and (q[:, :4] == upper[:4]).any()


def test_a_joint_that_starts_beyond_a_limit_may_only_come_back() -> None:
    lower, upper = -torch.ones(2).double(), torch.ones(2).double()
    q = torch.tensor([[1.5, -1.5], [1.5, -1.5]]).double()
    inward = torch.zeros(2, 8).double()
    inward[0, 6:], inward[1, 6:] = torch.tensor([1.0, -1.0]), torch.tensor([-1.0, 1.0])
    T = torch.eye(4).double().expand(2, 4, 4)
    _, moved, _ = PAPER.step(T, q, inward, torch.zeros_like(inward), torch.zeros(2).long(), lower, upper)
    torch.testing.assert_close(moved[0], torch.tensor([1.5, -1.5]).double() - 0.02 / np.sqrt(2) * torch.tensor([1, -1]))
    assert torch.equal(moved[1], q[1])


def test_single_precision_stays_single() -> None:
    T, q, gradient = (x.float() for x in state(4))
    stages = torch.zeros(4, dtype=torch.int64)
    for out in PAPER.step(T, q, gradient, torch.zeros_like(gradient), stages, -FREE.float(), FREE.float()):
        assert out.dtype == torch.float32 and torch.isfinite(out).all()


def test_the_schedule_shrinks_at_its_shares() -> None:
    solver = Descent(iterations=200, shares=(0.5, 0.8), factors=(0.1, 0.01))
    assert [solver.first_stage(i) for i in (0, 99, 100, 159, 160, 199)] == [0, 0, 1, 1, 2, 2]
    assert Descent(shares=(), factors=()).first_stage(1999) == 0


@pytest.mark.parametrize("momentum", [-0.1, 1.0, 1.5])
def test_a_momentum_that_never_forgets_is_refused(momentum: float) -> None:
    with refused(GraspRefineError, "momentum", "0", "1", f"{momentum:g}"):
        Descent(momentum=momentum)


def test_shares_and_factors_belong_together() -> None:
    with refused(GraspRefineError, "shares", "factors", "3", "2"):
        Descent(shares=(0.1, 0.2, 0.3))


def test_every_end_has_a_name_and_what_went_wrong_an_advice() -> None:
    assert Status.NO_TARGET.label == "no target" and Status.CONVERGED.label == "converged"
    for status in Status:
        assert bool(status.advice) == (status not in (Status.RUNNING, Status.CONVERGED))
    # Each thing that makes `Scene.sound` false.
    for fault in ("rigid", "1e6 m", "normal"):
        assert fault in Status.INVALID.advice
