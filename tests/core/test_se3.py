"""Rotations and rigid transforms: closed forms at 0, near 0 and at pi, in NumPy and torch, with their gradients."""

import numpy as np
import pytest
import torch
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from grasp_refine.core import se3

ANGLES = (0.0, 1e-12, 1e-9, 1e-6, 0.99e-4, 1.01e-4, 1e-2, 1.0, 3.0, np.pi - 1e-4, np.pi - 1e-8)
"""Rotation angles, on both sides of where the Taylor series take over (1e-4 rad)."""

TOLERANCE = {torch.float64: 1e-13, torch.float32: 2e-6}


def axes(count: int, seed: int = 0) -> np.ndarray:
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    directions[:3] = np.eye(3)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def twists(angle: float, count: int = 20) -> np.ndarray:
    linear = np.random.default_rng(1).normal(size=(count, 3))
    return np.concatenate([linear, angle * axes(count)], axis=1)


def generators(twist: np.ndarray) -> np.ndarray:
    """Matrices (..., 4, 4) of twists (v, w), written out by hand."""
    (vx, vy, vz), (wx, wy, wz) = np.moveaxis(twist[..., :3], -1, 0), np.moveaxis(twist[..., 3:], -1, 0)
    zero = np.zeros_like(vx)
    rows = [[zero, -wz, wy, vx], [wz, zero, -wx, vy], [-wy, wx, zero, vz], [zero, zero, zero, zero]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def poses(count: int, seed: int = 2) -> np.ndarray:
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, random_state=seed).as_matrix()
    T[:, :3, 3] = rng.normal(size=(count, 3))
    return T


# exponential and logarithm


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_is_the_matrix_exponential(angle: float) -> None:
    twist = twists(angle)
    expected = np.array([expm(generator) for generator in generators(twist)])
    np.testing.assert_allclose(se3.exp_se3(twist), expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(se3.exp_so3(twist[:, 3:]), expected[:, :3, :3], rtol=0, atol=1e-14)


@pytest.mark.parametrize("angle", ANGLES)
def test_log_inverts_exp(angle: float) -> None:
    twist = twists(angle)
    # Half a turn has two logarithms, and a rotation that is rounded to 1e-16 tells the axis to 1e-8 there.
    tolerance = 1e-12 if angle < 3.1 else 1e-7
    np.testing.assert_allclose(se3.log_se3(se3.exp_se3(twist)), twist, rtol=0, atol=tolerance)
    np.testing.assert_allclose(se3.log_so3(se3.exp_so3(twist[:, 3:])), twist[:, 3:], rtol=0, atol=tolerance)


def test_log_of_tiny_rotations_keeps_their_relative_accuracy() -> None:
    w = 1e-12 * axes(20)
    np.testing.assert_allclose(se3.log_so3(se3.exp_so3(w)), w, rtol=1e-3, atol=1e-16)


@pytest.mark.parametrize("axis", [*np.eye(3), *-np.eye(3), *axes(8)[3:]])
def test_log_at_half_a_turn(axis: np.ndarray) -> None:
    R = 2.0 * np.outer(axis, axis) - np.eye(3)
    w = se3.log_so3(R)
    assert np.linalg.norm(w) == pytest.approx(np.pi, abs=1e-12)
    np.testing.assert_allclose(np.abs(w @ axis), np.pi, atol=1e-12)
    np.testing.assert_allclose(se3.exp_so3(w), R, atol=1e-14)


@pytest.mark.parametrize("dtype", TOLERANCE)
@pytest.mark.parametrize("angle", (*ANGLES, np.pi))
def test_torch_and_numpy_agree(angle: float, dtype: torch.dtype) -> None:
    twist = twists(angle)
    T = se3.exp_se3(twist)
    tolerance = TOLERANCE[dtype]
    for name, argument in (
        ("exp_se3", twist),
        ("exp_so3", twist[:, 3:]),
        ("inverse", T),
        ("adjoint", T),
        ("quaternion_from_matrix", T[:, :3, :3]),
        ("pose_from_transform", T),
    ):
        expected = getattr(se3, name)(argument)
        found = getattr(se3, name)(torch.as_tensor(argument, dtype=dtype))
        assert found.dtype == dtype
        if dtype == torch.float32 and angle > 3.1 and name in ("quaternion_from_matrix", "pose_from_transform"):
            # q and -q are the same rotation, and rounding decides between them.
            found, expected = se3.matrix_from_quaternion(found[:, -4:]), se3.matrix_from_quaternion(expected[:, -4:])
        np.testing.assert_allclose(found.numpy(), expected, atol=10 * tolerance)
    if angle < 3.1:
        found = se3.log_se3(torch.as_tensor(T, dtype=dtype))
        assert found.dtype == dtype
        np.testing.assert_allclose(found.numpy(), twist, atol=100 * tolerance)


@pytest.mark.parametrize("angle", ANGLES)
def test_gradient_of_exp_is_its_derivative(angle: float) -> None:
    twist, weight = twists(angle), np.random.default_rng(3).normal(size=(4, 4))
    tensor = torch.from_numpy(twist).requires_grad_()
    (se3.exp_se3(tensor) * torch.from_numpy(weight)).sum().backward()
    h = 1e-6
    slopes = [
        (weight * (se3.exp_se3(twist + h * unit) - se3.exp_se3(twist - h * unit))).sum((1, 2)) / (2 * h)
        for unit in np.eye(6)
    ]
    np.testing.assert_allclose(tensor.grad.numpy(), np.transpose(slopes), atol=2e-9)


@pytest.mark.parametrize("angle", [angle for angle in ANGLES if angle < 3.1])
def test_gradient_of_log_is_its_derivative(angle: float) -> None:
    T, weight = se3.exp_se3(twists(angle)), np.random.default_rng(4).normal(size=6)
    tensor = torch.from_numpy(T).requires_grad_()
    (se3.log_se3(tensor) @ torch.from_numpy(weight)).sum().backward()
    h = 1e-6
    for generator in generators(np.eye(6)):
        direction = T @ generator
        ends = [se3.log_se3(T @ expm(sign * h * generator)) @ weight for sign in (1, -1)]
        along = (tensor.grad.numpy() * direction).sum((1, 2))
        np.testing.assert_allclose(along, (ends[0] - ends[1]) / (2 * h), atol=1e-8)


@pytest.mark.parametrize("dtype", TOLERANCE)
@pytest.mark.parametrize("angle", (*ANGLES, np.pi))
def test_gradients_are_finite_and_of_the_right_size_everywhere(angle: float, dtype: torch.dtype) -> None:
    twist = torch.as_tensor(twists(angle), dtype=dtype).requires_grad_()
    T = se3.exp_se3(twist)
    T.retain_grad()
    se3.log_se3(T).sum().backward()
    assert torch.isfinite(T.grad).all()
    # log(exp(x)) = x, whatever lies between, as long as that is the principal logarithm.
    if angle < 3.1:
        tolerance = 1e-6 if dtype == torch.float64 else 2e-2
        np.testing.assert_allclose(twist.grad.numpy(), 1.0, atol=tolerance)
    else:
        assert torch.isfinite(twist.grad).all()


# transforms


def test_small_operations_match_numpy() -> None:
    a, b = np.random.default_rng(5).normal(size=(2, 4, 7, 3))
    np.testing.assert_allclose(se3.cross(a, b), np.cross(a, b), atol=1e-15)
    np.testing.assert_allclose(se3.matvec(se3.hat(a), b), np.cross(a, b), atol=1e-15)
    np.testing.assert_allclose(se3.vee(se3.hat(a)), a, atol=1e-15)
    symmetric = np.random.default_rng(6).normal(size=(3, 3))
    np.testing.assert_allclose(se3.vee(symmetric + symmetric.T), 0.0, atol=1e-15)


def test_inverse_and_points() -> None:
    T, p = poses(6), np.random.default_rng(7).normal(size=(6, 3))
    np.testing.assert_allclose(se3.inverse(T), np.linalg.inv(T), atol=1e-14)
    homogeneous = np.concatenate([p, np.ones((6, 1))], axis=1)
    np.testing.assert_allclose(se3.transform_points(T, p), np.einsum("nij,nj->ni", T, homogeneous)[:, :3], atol=1e-14)
    np.testing.assert_array_equal(se3.transform(T[:, :3, :3], T[:, :3, 3]), T)


def test_adjoint_carries_twists_along() -> None:
    T, twist = poses(6), np.random.default_rng(8).normal(size=(6, 6))
    left = T @ se3.exp_se3(twist) @ se3.inverse(T)
    np.testing.assert_allclose(left, se3.exp_se3(se3.matvec(se3.adjoint(T), twist)), atol=1e-13)
    # The power of a wrench is the same seen from either frame.
    other = poses(6, seed=9)
    np.testing.assert_allclose(se3.adjoint(T @ other), se3.adjoint(T) @ se3.adjoint(other), atol=1e-13)


def test_retract_moves_by_a_body_twist() -> None:
    T, twist = poses(6), np.random.default_rng(10).normal(size=(6, 6))
    np.testing.assert_allclose(se3.retract(T, twist), T @ se3.exp_se3(twist), atol=1e-13)


def test_retract_stays_a_rotation_for_2000_single_precision_steps() -> None:
    T = torch.eye(4)[None]
    move = torch.tensor([[1e-3, 0.0, 0.0, 0.03, -0.02, 0.05]])
    drifting = torch.eye(3)
    for _ in range(2000):
        T = se3.retract(T, move)
        drifting = drifting @ se3.exp_so3(move[0, 3:])
    R = T[0, :3, :3].double()
    assert (R.T @ R - torch.eye(3)).abs().max() < 5e-7
    assert torch.linalg.det(R).item() == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_array_equal(T[0, 3], [0.0, 0.0, 0.0, 1.0])


# gradients as wrenches and twists


def test_ambient_gradient_pairs_like_its_wrench() -> None:
    rng = np.random.default_rng(11)
    T, wrench, twist = poses(6), rng.normal(size=(6, 6)), rng.normal(size=(6, 6))
    G = se3.ambient_gradient(T, wrench)
    np.testing.assert_array_equal(G[:, 3], 0.0)
    power = (G * (generators(twist) @ T)).sum((1, 2))
    np.testing.assert_allclose(power, (wrench * twist).sum(1), atol=1e-13)
    torch.testing.assert_close(torch.from_numpy(G), se3.ambient_gradient(torch.from_numpy(T), torch.from_numpy(wrench)))


def test_body_gradient_has_half_the_derivative_along_body_rotations() -> None:
    rng = np.random.default_rng(12)
    T, G = poses(6), rng.normal(size=(6, 4, 4))
    found = se3.body_gradient(T, G)
    # The loss <G, T>: its derivative along T exp(t xi).
    slopes = np.stack([(G * (T @ generator)).sum((1, 2)) for generator in generators(np.eye(6))], axis=1)
    np.testing.assert_allclose(found, slopes * [1, 1, 1, 0.5, 0.5, 0.5], atol=1e-13)


def test_body_gradient_of_a_wrench_is_that_wrench_seen_from_the_body() -> None:
    T, wrench = poses(6), np.random.default_rng(13).normal(size=(6, 6))
    found = se3.body_gradient(T, se3.ambient_gradient(T, wrench))
    seen = se3.matvec(se3.adjoint(T).mT, wrench)
    np.testing.assert_allclose(found, seen * [1, 1, 1, 0.5, 0.5, 0.5], atol=1e-13)


# quaternions


def test_quaternions_are_w_first_and_match_scipy() -> None:
    quarter = se3.quaternion_from_matrix(se3.exp_so3(np.array([0.0, 0.0, np.pi / 2])))
    np.testing.assert_allclose(np.abs(quarter), [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], atol=1e-15)
    turns = Rotation.random(50, random_state=14)
    xyzw = turns.as_quat()
    np.testing.assert_allclose(se3.matrix_from_quaternion(xyzw[:, [3, 0, 1, 2]]), turns.as_matrix(), atol=1e-14)


@pytest.mark.parametrize("angle", (*ANGLES, np.pi))
def test_poses_go_there_and_back(angle: float) -> None:
    T = se3.exp_se3(twists(angle))
    pose = se3.pose_from_transform(T)
    assert (pose[:, 3] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(pose[:, 3:], axis=1), 1.0, atol=1e-14)
    np.testing.assert_allclose(se3.transform_from_pose(pose), T, atol=1e-13)


def test_every_function_takes_any_batch_shape() -> None:
    twist = np.random.default_rng(15).normal(size=(2, 3, 6))
    T = se3.exp_se3(twist)
    assert se3.log_se3(T).shape == (2, 3, 6) and se3.adjoint(T).shape == (2, 3, 6, 6)
    assert se3.pose_from_transform(T).shape == (2, 3, 7) and se3.retract(T, twist).shape == (2, 3, 4, 4)
    np.testing.assert_allclose(T[1, 2], se3.exp_se3(twist[1, 2]), atol=1e-15)
    assert se3.exp_se3(np.zeros((0, 6))).shape == (0, 4, 4) and se3.log_se3(np.zeros((0, 4, 4))).shape == (0, 6)


def test_tangents_are_a_basis_for_every_normal() -> None:
    n = np.random.default_rng(5).normal(size=(100, 3))
    n[:6], n[6:9] = np.concatenate([np.eye(3), -np.eye(3)]), [[0, 1e-9, -1], [1e-9, 0, 1], [1, 0, -1e-300]]
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    frame = np.concatenate([se3.tangents(n), n[:, :, None]], axis=2)
    np.testing.assert_allclose(frame.mT @ frame, np.tile(np.eye(3), (100, 1, 1)), atol=1e-14)
    assert (np.linalg.det(frame) > 0).all()
