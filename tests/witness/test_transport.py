"""Equivalent gradient transport: moving one body as good as moving the other."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from grasp_refine.core.se3 import body_gradient, exp_se3, inverse
from grasp_refine.witness.transport import EquivalentTransport, transport
from twists import adjoint

twists = arrays(np.float64, 6, elements=st.floats(-2.0, 2.0))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(twists, twists, twists)
def test_the_other_body_moves_to_the_same_effect(pose_a: np.ndarray, pose_b: np.ndarray, xi_b: np.ndarray) -> None:
    T_a, T_b = exp_se3(pose_a), exp_se3(pose_b)
    tensors = [torch.from_numpy(x) for x in (T_b, T_a, xi_b)]
    xi_a = transport(*tensors).numpy()
    moved_a = inverse(T_a @ exp_se3(-xi_a)) @ T_b
    moved_b = inverse(T_a) @ T_b @ exp_se3(-xi_b)
    np.testing.assert_allclose(moved_a, moved_b, atol=1e-11)


def poses(seed: int, *shape: int) -> torch.Tensor:
    return torch.from_numpy(exp_se3(np.random.default_rng(seed).normal(size=(*shape, 6))))


@pytest.mark.parametrize("steps", [(1.0, 1.0), (1e-3, 1e-2), (0.5, 0.01)])
def test_the_backward_pass_adds_the_scaled_update_to_the_moving_body(steps: tuple[float, float]) -> None:
    T_a, T_b = poses(1, 4, 3).requires_grad_(), poses(2, 4, 3).requires_grad_()
    G_a, G_b = torch.from_numpy(np.random.default_rng(3).normal(size=(2, 4, 3, 4, 4)))
    moving, resting = EquivalentTransport(*steps)(T_a, T_b)
    assert torch.equal(moving, T_a) and torch.equal(resting, T_b)
    torch.autograd.backward((moving, resting), (G_a, G_b))
    # The resting body keeps its gradient; nothing is done to it twice.
    assert torch.equal(T_b.grad, G_b)
    # An update is -(v s_t, w s_r): the two together move the pair as the sum of both updates would.
    scale = torch.tensor([steps[0]] * 3 + [steps[1]] * 3, dtype=torch.float64)
    own = body_gradient(T_a.detach(), G_a) * scale
    other = transport(T_b.detach(), T_a.detach(), body_gradient(T_b.detach(), G_b) * scale)
    torch.testing.assert_close(body_gradient(T_a.detach(), T_a.grad) * scale, own + other)


@pytest.mark.parametrize("steps", [(1.0, 1.0), (1e-3, 1e-2)])
def test_where_both_move_each_gets_the_others_update(steps: tuple[float, float]) -> None:
    T_a, T_b = poses(21, 4, 3).requires_grad_(), poses(22, 4, 3).requires_grad_()
    G = torch.from_numpy(np.random.default_rng(23).normal(size=(2, 4, 3, 4, 4)))
    torch.autograd.backward(EquivalentTransport(*steps, both=True)(T_a, T_b), tuple(G))
    scale = torch.tensor([steps[0]] * 3 + [steps[1]] * 3, dtype=torch.float64)
    for (T, own), (T_other, other) in (((T_a, G[0]), (T_b, G[1])), ((T_b, G[1]), (T_a, G[0]))):
        update = body_gradient(T.detach(), own) * scale
        theirs = transport(T_other.detach(), T.detach(), body_gradient(T_other.detach(), other) * scale)
        torch.testing.assert_close(body_gradient(T.detach(), T.grad) * scale, update + theirs)


@pytest.mark.parametrize("both", [False, True])
def test_transported_gradients_flow_through_a_chain_to_root_and_joints(both: bool) -> None:
    """Root and joint gradients are those of the explicit formula J^T (xi_link + xi~_link)."""
    steps = EquivalentTransport(2e-3, 5e-2, both=both)
    root, T_object = poses(30).requires_grad_(), poses(31).requires_grad_()
    q = torch.tensor([0.3, -0.7], dtype=torch.float64, requires_grad=True)
    offsets, axes = poses(32, 2), torch.from_numpy(np.random.default_rng(33).normal(size=(2, 6)))
    G_link, G_object = torch.from_numpy(np.random.default_rng(34).normal(size=(2, 4, 4)))

    chain = offsets[0] @ exp_se3(q[0] * axes[0]) @ offsets[1] @ exp_se3(q[1] * axes[1])
    link = root @ chain
    torch.autograd.backward(steps(link, T_object), (G_link, G_object))

    with torch.no_grad():
        scale = torch.tensor([steps.step_translation] * 3 + [steps.step_rotation] * 3, dtype=torch.float64)
        carried = transport(T_object, link, body_gradient(T_object, G_object) * scale) / scale
        total = body_gradient(link, G_link) + carried
        covector = total * torch.tensor([1.0, 1, 1, 2, 2, 2])  # `body_gradient` halves rotations
        # Body twists of the link that a body twist of the root and the two joints cause.
        carried_by, of_root = (
            torch.from_numpy(adjoint(inverse(T).numpy())) for T in (offsets[1] @ exp_se3(q[1] * axes[1]), chain)
        )
        of_joints = [carried_by @ axes[0], axes[1]]
        for_root = of_root.mT @ covector
        for_q = torch.stack([twist @ covector for twist in of_joints])
        back = transport(link, T_object, body_gradient(link, G_link) * scale) / scale
        expected_object = body_gradient(T_object, G_object) + (back if both else 0.0)
        found_root = body_gradient(root, root.grad) * torch.tensor([1.0, 1, 1, 2, 2, 2])
    torch.testing.assert_close(found_root, for_root)
    torch.testing.assert_close(q.grad, for_q)
    torch.testing.assert_close(body_gradient(T_object.detach(), T_object.grad), expected_object)
