"""Distance smoothing: the softmax and its derivative, what the slip matrix is, and how large its bias is."""

from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.se3 import inverse, transform_points
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import sphere
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.distance import Distance, scores_of, smooth, temperature
from grasp_refine.witness.neighborhood import Adaptive, Neighbors
from grasp_refine.witness.scene import WitnessScene
from shapes_for_tests import convex_body
from twists import poses_at_gap

ALL = Distance(Adaptive(samples=None))


def cloud(count: int = 12, batch: int = 4, seed: int = 0) -> tuple[Neighbors, np.ndarray]:
    """Random samples, some of them padding, and points above them."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(2, batch, count, 3)) * [0.01, 0.01, 0.002]
    mask = rng.random((2, batch, count)) < 0.7
    mask[..., :3] = True
    normals = np.tile([0.0, 0.0, 1.0], (2, batch, count - 1, 1))
    near = Neighbors(points, normals, mask, np.full((2, batch), 0.02), np.full((2, batch), 1e-9))
    return near, rng.normal(size=(2, batch, 3)) * [0.005, 0.005, 0] + [0, 0, 0.01]


def scene_of(pairs: Pairs, T_a: np.ndarray, T_b: np.ndarray, key: int = 0, target_a: object = None) -> WitnessScene:
    columns = WitnessLayer(pairs, ALL).columns(np.arange(len(pairs)))
    return WitnessScene(*columns, T_a, T_b, query(pairs, T_a, T_b), target_a, None, key)


def test_the_smoothed_point_is_the_softmax_of_the_definition() -> None:
    near, y = cloud()
    smoothed, slip = smooth(near, y)
    for s in range(2):
        for b in range(4):
            v = near.points[s, b][near.mask[s, b]]
            scores = -((v - y[s, b]) ** 2).sum(axis=1)
            tau = scores.std()
            assert temperature(near, scores_of(near, y))[s, b] == pytest.approx(tau, rel=1e-12)
            w = np.exp(scores / tau) / np.exp(scores / tau).sum()
            np.testing.assert_allclose(smoothed[s, b], w @ v, atol=1e-15)
            centered = v - w @ v
            np.testing.assert_allclose(slip[s, b], 2 / tau * (centered * w[:, None]).T @ centered, rtol=1e-9)


def test_its_derivative_holds_samples_and_temperature_fixed() -> None:
    near, y = cloud(seed=1)
    tau = 0.3 * temperature(near, scores_of(near, y))
    _, slip = smooth(near, y, tau)
    h = 1e-6
    for k in range(3):
        step = h * np.eye(3)[k]
        slope = (smooth(near, y + step, tau)[0] - smooth(near, y - step, tau)[0]) / (2 * h)
        np.testing.assert_allclose(slip[..., k], slope, atol=1e-7)
    # With the temperature free it would be another one: what is held fixed matters.
    free = (smooth(near, y + step)[0] - smooth(near, y - step)[0]) / (2 * h)
    assert np.abs(smooth(near, y)[1][..., 2] - free).max() > 1e-3


def test_the_temperature_has_a_floor() -> None:
    near, y = cloud(seed=2)
    np.testing.assert_array_equal(temperature(replace(near, floor=np.full((2, 4), 9.0)), scores_of(near, y)), 9.0)
    # One sample has no spread: it is the smoothed point, and it does not move.
    one = np.zeros_like(near.mask)
    one[..., 0] = True
    smoothed, slip = smooth(replace(near, mask=one), y)
    np.testing.assert_allclose(smoothed, near.points[:, :, 0], atol=1e-15)
    np.testing.assert_allclose(slip, 0.0, atol=1e-15)


def test_the_neighbourhood_narrows_as_the_target_is_reached() -> None:
    pairs = Pairs((build_body("ball", [sphere(0.05)]),), (convex_body(1),))
    T_a, T_b = poses_at_gap(pairs, 3, 0.01, seed=8)
    at = transform_points(inverse(T_a), query(pairs, T_a, T_b).point_a)
    method = Distance(Adaptive(samples=None), smoothed_self=True)
    away = []
    for offset in (0.0, 0.02, 0.04):
        scene = scene_of(pairs, T_a, T_b, target_a=at + [offset, 0, 0])
        away.append(np.linalg.norm(method.slip(scene).self_a - scene.witness.point_a, axis=-1).mean())
    assert away[0] < away[1] < away[2] and away[0] < scene.surfaces.spacing[0]
