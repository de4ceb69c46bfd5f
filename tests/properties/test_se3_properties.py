"""The maps of SE(3) forwards and backwards, at 0, near 0, near pi: extended precision and rounding errors, no more."""

import numpy as np
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from exact_twists import DTYPES, Long, axes, exact_exp, exact_right_jacobian, generator, twists
from grasp_refine.core import se3

dtypes = st.sampled_from(DTYPES)


def eps(dtype: str) -> float:
    return float(np.finfo(dtype).eps)


def size(twist: np.ndarray) -> float:
    """What lengths that come of a twist compare with, in metres."""
    return float(np.linalg.norm(twist[:3]))


def error(found: np.ndarray, exact: np.ndarray, length: float) -> float:
    """Largest difference of transforms (4, 4): entries of rotations as they are, those of positions over a length."""
    away = np.abs(found.astype(Long) - exact)
    assert np.isfinite(away).all() and not away[3].any()
    return float(max(away[:3, :3].max(), away[:3, 3].max() / length if length else away[:3, 3].max()))


@st.composite
def weights(draw: st.DrawFn, *shape: int) -> np.ndarray:
    """Normally distributed numbers: the covector that a loss puts on what a map gives."""
    return np.random.default_rng(draw(st.integers(0, 2**32))).normal(size=shape)


# forwards


@given(twists(), dtypes)
def test_exp_is_the_power_series(twist: np.ndarray, dtype: str) -> None:
    twist = twist.astype(dtype)
    exact = exact_exp(twist)
    for array in (twist, torch.from_numpy(twist)):
        T, R = np.asarray(se3.exp_se3(array)), np.asarray(se3.exp_so3(array[3:]))
        assert T.dtype == R.dtype == dtype
        assert error(T, exact, size(twist)) < 8 * eps(dtype)
        assert np.abs(R - exact[:3, :3]).max() < 8 * eps(dtype)


@given(twists(), dtypes)
def test_the_exponential_of_log_is_the_rotation(twist: np.ndarray, dtype: str) -> None:
    """At half a turn there are two logarithms, and either will do: both lead to the same rotation."""
    exact = exact_exp(twist)[:3, :3]
    R = exact.astype(dtype)
    for array in (R, torch.from_numpy(R)):
        w = np.asarray(se3.log_so3(array))
        assert w.dtype == dtype
        assert np.linalg.norm(w.astype(Long)) < np.pi * (1 + 2 * eps(dtype))
        assert np.abs(exact_exp(np.concatenate([np.zeros(3), w]))[:3, :3] - exact).max() < 24 * eps(dtype)


@given(twists(), dtypes)
def test_log_gives_the_rotation_vector_back_to_its_last_digits(twist: np.ndarray, dtype: str) -> None:
    """An angle of 1e-9 rad too is there to all its digits: sines do not cancel."""
    twist = twist.astype(dtype)
    angle = float(np.linalg.norm(twist[3:].astype(Long)))
    found = se3.log_so3(exact_exp(twist)[:3, :3].astype(dtype)).astype(Long)
    # Rounding moves a rotation by eps, which a quarter turn before half a turn may become the other axis.
    if angle < np.pi - 1e4 * eps(dtype):
        assert np.abs(found - twist[3:]).max() < 40 * eps(dtype) * angle + np.finfo(dtype).tiny


@given(twists(), dtypes)
def test_poses_and_matrices_are_the_same_places(twist: np.ndarray, dtype: str) -> None:
    """Quaternions are scipy's, w first and not negative, and take transforms there and back."""
    T = exact_exp(twist).astype(dtype)
    for array in (T, torch.from_numpy(T)):
        pose = np.asarray(se3.pose_from_transform(array))
        assert pose.dtype == dtype and pose[3] >= 0.0
        assert abs(np.linalg.norm(pose[3:].astype(Long)) - 1.0) < 4 * eps(dtype)
        known = Rotation.from_rotvec(twist[3:]).as_matrix()
        there = Rotation.from_quat(pose[[4, 5, 6, 3]].astype(np.float64)).as_matrix()
        assert np.abs(there - known).max() < 8 * eps(dtype)
        assert error(np.asarray(se3.transform_from_pose(pose)), exact_exp(twist), size(twist)) < 12 * eps(dtype)


@given(twists(), dtypes)
def test_inverse_is_that_of_the_group(place: np.ndarray, dtype: str) -> None:
    """T T^-1 = 1."""
    T = exact_exp(place).astype(dtype)
    length = size(place) + np.finfo(dtype).tiny
    assert error(T.astype(Long) @ se3.inverse(T), np.eye(4, dtype=Long), length) < 12 * eps(dtype)


@given(twists(), twists(), dtypes)
def test_retract_follows_the_twist_and_gives_a_rotation(place: np.ndarray, twist: np.ndarray, dtype: str) -> None:
    T, twist = exact_exp(place).astype(dtype), twist.astype(dtype)
    found = se3.retract(T, twist)
    assert found.dtype == dtype
    assert error(found, exact_exp(place) @ exact_exp(twist), size(place) + size(twist)) < 24 * eps(dtype)
    R = found[:3, :3].astype(Long)
    assert np.abs(R.T @ R - np.eye(3)).max() < 6 * eps(dtype)


@given(axes())
def test_tangents_complete_a_rotation(normal: np.ndarray) -> None:
    for dtype in DTYPES:
        n = normal.astype(dtype)
        frame = np.concatenate([se3.tangents(n), n[:, None]], axis=1).astype(Long)
        assert np.abs(frame.T @ frame - np.eye(3)).max() < 8 * eps(dtype)
        assert np.linalg.det(frame.astype(np.float64)) > 0


# backwards


def gradient(value: torch.Tensor, covector: np.ndarray, leaf: torch.Tensor) -> np.ndarray:
    """Gradient of the sum of value times covector, in extended precision."""
    (found,) = torch.autograd.grad((value * torch.from_numpy(covector).to(value)).sum(), leaf)
    assert torch.isfinite(found).all()
    return found.numpy().astype(Long)


@example(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 1e-3]), np.eye(4, k=2) + np.eye(4, k=3), "float32")
@given(twists(), weights(4, 4), dtypes)
def test_gradients_of_exp_are_its_derivative(twist: np.ndarray, covector: np.ndarray, dtype: str) -> None:
    """<G, dT> with dT = T [J dx], where rotations are weighed like lengths of the twist's own size.

    (x - sin x)/x^3 cancels: in single precision, gradients at a thousandth of a radian were good to four digits only.
    """
    twist, covector = twist.astype(dtype), covector.astype(dtype)
    covector[:3, 3] /= size(twist) or 1.0
    leaf = torch.from_numpy(twist).requires_grad_()
    found = gradient(se3.exp_se3(leaf), covector, leaf)
    T, J = exact_exp(twist), exact_right_jacobian(twist)
    exact = np.array([(covector * (T @ generator(column))).sum() for column in J.T])
    scale = np.abs(covector[:3]).max() if size(twist) == 0 else np.array([1 / size(twist)] * 3 + [1.0] * 3)
    assert (np.abs(found - exact) < 64 * eps(dtype) * scale).all()


@example(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 1e-3]), np.ones(3), "float32")
@given(twists(), weights(3), dtypes)
def test_gradients_of_log_are_its_derivative(twist: np.ndarray, covector: np.ndarray, dtype: str) -> None:
    """Along R exp(dx) the vector changes by J^-1 dx, up to half a turn, where the logarithm jumps."""
    R = exact_exp(twist)[:3, :3].astype(dtype)
    covector = covector.astype(dtype)
    leaf = torch.from_numpy(R).requires_grad_()
    found = gradient(se3.log_so3(leaf), covector, leaf)
    at = se3.log_so3(exact_exp(twist)[:3, :3].astype(np.float64))  # half a turn has two, here that of the map
    if np.linalg.norm(twist[3:]) > np.pi - 1e4 * eps(dtype):
        at = np.asarray(se3.log_so3(R), dtype=np.float64)
    J = exact_right_jacobian(np.concatenate([np.zeros(3), at]))[3:, 3:]
    exact = covector.astype(np.float64) @ np.linalg.inv(J.astype(np.float64))
    tangents = [R.astype(Long) @ generator(unit)[:3, :3] for unit in np.eye(6)[3:]]
    along = np.array([(found * tangent).sum() for tangent in tangents])
    assert (np.abs(along - exact) < 300 * eps(dtype)).all()
