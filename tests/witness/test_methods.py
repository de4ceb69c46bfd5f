"""The other derivative methods of the paper: what each is exact for, and its blind spot."""

import numpy as np
import pytest

from grasp_refine.collision.query import Pairs, query
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import box, capsule, hull, sphere
from grasp_refine.witness.analytical import Analytical, feature_slip
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.direction import Direction
from grasp_refine.witness.finite_difference import FiniteDifference
from grasp_refine.witness.neighborhood import choose, draw_offset
from grasp_refine.witness.rigid import Rigid
from grasp_refine.witness.scene import WitnessScene
from grasp_refine.witness.slip import Slip
from grasp_refine.witness.zeroth_order import ZerothOrder
from twists import (
    contracted,
    layer_gradient,
    poses_at_gap,
    random_cotangents,
    slip_velocities,
    slopes_along_twists,
)

POINTS = ("point_a", "point_b")


def body(*pieces: object) -> Body:
    return build_body("body", pieces, candidates=256)


def ball_and_capsule() -> Pairs:
    return Pairs((body(sphere(0.03, (0.01, 0, 0))),), (body(capsule(0.02, (0, 0, -0.02), (0, 0, 0.02))),))


@pytest.mark.parametrize("gap", [0.02, 0.002, -0.004])
@pytest.mark.parametrize("method", [Analytical(), FiniteDifference(step=1e-4)], ids=["analytical", "finite difference"])
def test_round_bodies_are_followed_exactly(method: Analytical | FiniteDifference, gap: float) -> None:
    pairs = ball_and_capsule()
    T_a, T_b = poses_at_gap(pairs, 8, gap, seed=1)
    cotangents = random_cotangents(query(pairs, T_a, T_b), (*POINTS, "distance"), seed=2)
    expected = slopes_along_twists(lambda a, b: contracted(query(pairs, a, b), cotangents), T_a, T_b, 1e-5)
    found = layer_gradient(WitnessLayer(pairs, method), T_a, T_b, cotangents)
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_zeroth_order_estimates_the_smooth_derivative() -> None:
    pairs = ball_and_capsule()
    T_a, T_b = poses_at_gap(pairs, 8, 0.01, seed=5)
    cotangents = random_cotangents(query(pairs, T_a, T_b), POINTS, seed=6)
    expected = slopes_along_twists(lambda a, b: contracted(query(pairs, a, b), cotangents), T_a, T_b, 1e-5)
    errors = []
    for samples in (20, 2000):
        found = layer_gradient(WitnessLayer(pairs, ZerothOrder(sigma=1e-3, samples=samples)), T_a, T_b, cotangents)
        errors.append(np.linalg.norm(found - expected) / np.linalg.norm(expected))
    assert errors[1] < 0.1 and errors[1] < errors[0] / 3  # falls as the square root of the samples


def scene_of(pairs: Pairs, T_a: np.ndarray, T_b: np.ndarray) -> WitnessScene:
    columns = WitnessLayer(pairs, Rigid()).columns(np.array([0]))
    return WitnessScene(*columns, T_a, T_b, query(pairs, T_a, T_b), None, None, 0)


@pytest.mark.parametrize(
    ("center", "expected"),
    [
        ((0.05, 0.001, 0.002), np.diag([0.0, 1.0, 1.0])),  # above a face
        ((0.05, 0.05, 0.002), np.diag([0.0, 0.0, 1.0])),  # beside an edge
        ((0.05, 0.05, 0.05), np.zeros((3, 3))),  # at a vertex: blind
    ],
)
def test_analytical_slip_is_that_of_the_feature(center: tuple[float, float, float], expected: np.ndarray) -> None:
    pairs = Pairs((body(box([0.04] * 3)),), (body(sphere(0.005)),))
    T_a = np.tile(np.eye(4), (1, 1, 1, 1))
    T_b = T_a.copy()
    T_b[0, 0, :3, 3] = center
    slip = Analytical().slip(scene_of(pairs, T_a, T_b))
    np.testing.assert_allclose(slip.A[0, 0], expected, atol=1e-9)


@pytest.mark.parametrize("off", [0.0, 1e-17, -1e-12, 1e-9])
def test_a_ball_with_its_centre_on_a_face_keeps_its_place(off: float) -> None:
    """There r + d is 0, by which the slip of the ball was divided."""
    up = np.array([0.0, 0.0, 1.0])
    A = feature_slip(sphere(0.02), 0.02 * up[None], up[None], np.array([-0.02 + off]), 1e-6)[0]
    assert np.isfinite(A).all() and np.abs(A).max() < 1.1e6
    x_a = 0.02 * up
    x_b = x_a - (0.02 - off) * up
    slip = Slip(A, np.diag([1.0, 1.0, 0.0]), x_a, x_b, sampled=False)
    slide, rest = np.array([0.3, -0.4, 0.0, 0.0, 0.0, 0.0]), np.zeros(6)
    # The ball takes both points along, the face none.
    for twists, expected in (((slide, rest), slide[:3]), ((rest, slide), rest[:3])):
        for dx in slip_velocities(slip, x_a, x_b, *twists):
            np.testing.assert_allclose(dx, expected, atol=1e-5)


@pytest.mark.parametrize("gap", [0.01, -0.004])
def test_direction_smoothing_differentiates_its_soft_support_point(gap: float) -> None:
    """dx = sC (dx_b - dx_a): with the temperature given, against differences of the softmax over all samples."""
    sign = np.sign(gap)
    pairs = Pairs((body(hull(np.random.default_rng(0).normal(size=(60, 3)) * 0.02)),), (body(sphere(0.01)),))
    T_a, T_b = poses_at_gap(pairs, 1, gap, seed=7)
    eps = 1e-5
    scene = scene_of(pairs, T_a, T_b)
    method = Direction(epsilon=eps / scene.length[0] ** 2, coupling="one-sided")
    A = method.slip(scene).A[0, 0]
    w = scene.witness
    sides = scene.sides()
    near = choose(method.neighborhood, scene.surfaces, sides.point, sides.normal, None, draw_offset(0, 0))
    points = (sides.rotation[0, 0] @ near.points[0, 0][near.mask[0, 0]].T).T

    def support(direction: np.ndarray) -> np.ndarray:
        scores = points @ direction / eps
        weights = np.exp(scores - scores.max())
        return weights @ points / weights.sum()

    direction = sign * (w.point_b - w.point_a)[0, 0]
    C = np.stack([(support(direction + 1e-7 * e) - support(direction - 1e-7 * e)) / 2e-7 for e in np.eye(3)], axis=1)
    np.testing.assert_allclose(A, np.linalg.solve(np.eye(3) + sign * C, sign * C), atol=1e-6)


def test_rigid_points_stay_on_their_bodies() -> None:
    pairs = ball_and_capsule()
    T_a, T_b = poses_at_gap(pairs, 3, 0.01, seed=10)
    w = query(pairs, T_a, T_b)
    f = random_cotangents(w, ("point_a",), seed=11)
    found = layer_gradient(WitnessLayer(pairs, Rigid()), T_a, T_b, f)
    for k in range(6):
        xi = np.eye(6)[k]
        move = np.einsum("bpi,bpi->b", f["point_a"], xi[:3] + np.cross(xi[3:], w.point_a))
        np.testing.assert_allclose(found[k], move, atol=1e-12)
    assert not found[6:].any()
