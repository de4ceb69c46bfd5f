"""Loss terms: the paper's residual in our form, masks, gradients."""

import numpy as np
import pytest
import torch
from twists import gradient_along_twists, poses_at_gap, random_poses, slopes_along_twists

from grasp_refine.collision.query import Pairs, query
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import hull, sphere
from grasp_refine.losses import contact_targets, joint_limits, penetration
from grasp_refine.se3 import inverse, transform_points
from grasp_refine.targets import automatic_targets
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.finite_difference import FiniteDifference


def layer() -> WitnessLayer:
    body = build_body("a", [hull(np.random.default_rng(0).normal(size=(50, 3)) * 0.02)], candidates=128)
    return WitnessLayer(Pairs((body,), (build_body("b", [sphere(0.03)], candidates=128),)), ContactKinematics())


@pytest.mark.parametrize("margin", [0.0, 1e-3])
@pytest.mark.parametrize("gap", [0.004, -0.002])
def test_contact_residual_has_the_square_of_the_papers(margin: float, gap: float) -> None:
    witness_layer = layer()
    T_a, T_b = (torch.from_numpy(T) for T in poses_at_gap(witness_layer.pairs, 5, gap, seed=1))
    w = witness_layer(T_a, T_b)
    t_a, t_b = torch.randn(2, 5, 1, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 0.02
    found = contact_targets(w, T_a, T_b, t_a, t_b, margin).square().sum((1, 2))
    gap_vector = w.point_a - w.point_b + margin * w.normal
    misses = w.point_a - transform_points(T_a, t_a), w.point_b - transform_points(T_b, t_b)
    expected = sum(r.square().sum((1, 2)) for r in (gap_vector, *misses))
    torch.testing.assert_close(found, expected, rtol=1e-9, atol=1e-15)


def test_pairs_without_target_or_witness_count_nothing() -> None:
    witness_layer = layer()
    T_a, T_b = (torch.from_numpy(T) for T in poses_at_gap(witness_layer.pairs, 3, 0.004, seed=2))
    T_b[2] = float("nan")
    T_a.requires_grad_()
    targets = torch.zeros(2, 3, 1, 3, dtype=torch.float64)
    targets[0, 1] = float("nan")
    residual = contact_targets(witness_layer(T_a, T_b), T_a, T_b, *targets, margin=1e-3)
    assert residual[0].any() and not residual[1:].any()
    residual.square().sum().backward()
    assert torch.isfinite(T_a.grad).all() and not T_a.grad[1:].any()


def test_penetration_and_limits_are_one_sided() -> None:
    witness_layer = layer()
    T_a, T_b = poses_at_gap(witness_layer.pairs, 2, -0.003, seed=3)
    T_b[1, ..., 0, 3] += 1.0
    w = witness_layer(*(torch.from_numpy(T) for T in (T_a, T_b)))
    np.testing.assert_allclose(penetration(w)[:, 0].numpy(), [0.003, 0.0], atol=1e-6)
    q = torch.tensor([[-2.0, 0.5, 3.0]])
    torch.testing.assert_close(
        joint_limits(q, torch.tensor([-1.0, 0, 0]), torch.ones(3)), torch.tensor([[1.0, 0, 2.0]])
    )


def test_automatic_targets_are_the_witness_points_within_reach() -> None:
    pairs = layer().pairs
    T_a, T_b = random_poses(20, 5), random_poses(20, 6)
    w = query(pairs, T_a, T_b)
    on_a, on_b = automatic_targets(w, T_a, T_b, reach=0.03)
    near = w.distance <= 0.03
    assert near.any() and not near.all()
    np.testing.assert_array_equal(np.isfinite(on_a).all(-1), near)
    np.testing.assert_allclose(transform_points(T_a, on_a)[near], w.point_a[near], atol=1e-12)
    np.testing.assert_allclose(on_b[near], transform_points(inverse(T_b), w.point_b)[near], atol=1e-12)


@pytest.mark.parametrize("side", ["a", "b"])
def test_a_target_on_one_side_only_is_no_target(side: str) -> None:
    witness_layer = layer()
    T_a, T_b = (torch.from_numpy(T).requires_grad_() for T in poses_at_gap(witness_layer.pairs, 2, 0.004, seed=4))
    targets = {name: torch.zeros(2, 1, 3, dtype=torch.float64) for name in "ab"}
    targets[side][0, 0, 1] = torch.nan
    residual = contact_targets(witness_layer(T_a, T_b), T_a, T_b, targets["a"], targets["b"])
    assert not residual[0].any() and residual[1].any()
    residual.square().sum().backward()
    for T in (T_a, T_b):
        assert torch.isfinite(T.grad).all() and not T.grad[0].any() and T.grad[1].any()


@pytest.mark.parametrize("gap", [0.004, -0.002])
def test_terms_have_the_gradients_of_finite_differences(gap: float) -> None:
    """Balls, whose witness points are followed exactly; each residual on its own, with random weights."""
    pairs = Pairs((build_body("a", [sphere(0.03, (0.01, 0, 0))]),), (build_body("b", [sphere(0.02)]),))
    witness_layer = WitnessLayer(pairs, FiniteDifference(step=1e-4))
    T_a, T_b = poses_at_gap(pairs, 3, gap, seed=5)
    rng = np.random.default_rng(6)
    t_a, t_b = torch.from_numpy(rng.normal(size=(2, 3, 1, 3)) * 0.03)
    weight = torch.from_numpy(rng.normal(size=(1, 7)))

    def loss(T_a: torch.Tensor, T_b: torch.Tensor) -> torch.Tensor:
        w = witness_layer(T_a, T_b)
        contact = contact_targets(w, T_a, T_b, t_a, t_b, margin=1e-3) * weight
        return contact.sum((1, 2)) + contact.square().sum((1, 2)) + 3.0 * penetration(w).sum(1)

    tensors = [torch.from_numpy(T).requires_grad_() for T in (T_a, T_b)]
    loss(*tensors).sum().backward()
    found = np.concatenate([gradient_along_twists(t.grad.numpy(), t.detach().numpy()) for t in tensors])
    expected = slopes_along_twists(lambda a, b: loss(*map(torch.from_numpy, (a, b))).numpy(), T_a, T_b, 1e-5)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_joint_limits_push_back_with_unit_slope() -> None:
    q = torch.tensor([[-1.5, 0.0, 0.7]], dtype=torch.float64, requires_grad=True)
    lower, upper = torch.tensor([-1.0, -1.0, -torch.inf]), torch.tensor([1.0, torch.inf, 0.5])
    joint_limits(q, lower, upper).sum().backward()
    np.testing.assert_array_equal(q.grad.numpy(), [[-1.0, 0.0, 1.0]])
