"""Rotations and rigid transforms: closed forms at 0, near 0 and at pi, in NumPy and torch, with their gradients."""

import numpy as np
from scipy.spatial.transform import Rotation

from grasp_refine.core import se3
from twists import adjoint


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


def test_small_operations_match_numpy() -> None:
    a, b = np.random.default_rng(5).normal(size=(2, 4, 7, 3))
    np.testing.assert_allclose(se3.cross(a, b), np.cross(a, b), atol=1e-15)
    np.testing.assert_allclose(se3.matvec(se3.hat(a), b), np.cross(a, b), atol=1e-15)
    np.testing.assert_allclose(se3.vee(se3.hat(a)), a, atol=1e-15)
    symmetric = np.random.default_rng(6).normal(size=(3, 3))
    np.testing.assert_allclose(se3.vee(symmetric + symmetric.T), 0.0, atol=1e-15)


# gradients as wrenches and twists


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
    seen = se3.matvec(adjoint(T).mT, wrench)
    np.testing.assert_allclose(found, seen * [1, 1, 1, 0.5, 0.5, 0.5], atol=1e-13)


def test_every_function_takes_any_batch_shape() -> None:
    twist = np.random.default_rng(15).normal(size=(2, 3, 6))
    T = se3.exp_se3(twist)
    assert se3.pose_from_transform(T).shape == (2, 3, 7) and se3.retract(T, twist).shape == (2, 3, 4, 4)
    np.testing.assert_allclose(T[1, 2], se3.exp_se3(twist[1, 2]), atol=1e-15)
    assert se3.exp_se3(np.zeros((0, 6))).shape == (0, 4, 4) and se3.log_so3(np.zeros((0, 3, 3))).shape == (0, 3)
