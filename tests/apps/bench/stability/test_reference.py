"""The reference of the benchmark of stability: against closed forms, and proven by the directions that bound it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from grasp_refine.geometry.pieces import Piece, box, capsule, hull, sphere
from grasp_refine_apps.bench.stability.bodies import make_pairs
from grasp_refine_apps.bench.stability.cases import Kind
from grasp_refine_apps.bench.stability.polytopes import outside, separations
from grasp_refine_apps.bench.stability.reference import Truths

RNG = np.random.default_rng(7)


def turned(seed: int) -> np.ndarray:
    return Rotation.random(rng=np.random.default_rng(seed)).as_matrix()


def offsets(count: int, size: float) -> np.ndarray:
    return np.random.default_rng(3).normal(size=(count, 3)) * size


def parted(a: Piece, b: Piece, R: np.ndarray, t: np.ndarray, n: np.ndarray) -> np.ndarray:
    return separations(a, b, np.broadcast_to(R, (len(t), 3, 3)), t, n)


def moved(R: np.ndarray, t: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points of the frame of the first piece in that of the second."""
    return (points - t) @ R


@pytest.mark.parametrize("size", [1e-6, 1e-3, 0.1, 10.0])
def test_spheres(size: float):
    a, b = sphere(0.3 * size, np.array([0.1, 0.2, -0.3]) * size), sphere(0.2 * size, np.array([0, 0.5, 0]) * size)
    R = turned(0)
    t = np.concatenate([offsets(50, size), [[0, 0, 1e3 * size], a.vertices[0] - R @ b.vertices[0]]])
    truth = Truths([a], [b], R).at(t)
    between = b.vertices[0] @ R.T + t - a.vertices[0]
    distance = np.linalg.norm(between, axis=1)
    np.testing.assert_allclose(truth.distance, distance - 0.5 * size, rtol=1e-15, atol=1e-15 * size)
    assert truth.unique[:-1].all() and not truth.unique[-1]  # concentric: any direction is as good
    n = between[:-1] / distance[:-1, None]
    np.testing.assert_allclose(truth.normal[:-1], n, rtol=0, atol=1e-12)
    np.testing.assert_allclose(truth.point_a[:-1], a.vertices[0] + 0.3 * size * n, rtol=0, atol=1e-12 * size)


def test_a_ball_and_a_box():
    half, radius = np.array([1.0, 2.0, 3.0]), 0.4
    t = offsets(500, 2.0)
    truth = Truths([box(2 * half)], [sphere(radius)], np.eye(3)).at(t)
    beyond = np.abs(t) - half
    expected = np.linalg.norm(beyond.clip(min=0), axis=1) + beyond.max(axis=1).clip(max=0) - radius
    assert (expected < -radius).sum() > 50 and (expected > 0).sum() > 50
    np.testing.assert_allclose(truth.distance, expected, rtol=0, atol=1e-14)
    apart = expected > 0
    np.testing.assert_allclose(truth.point_a[apart], t[apart].clip(-half, half), rtol=0, atol=1e-14)
    assert truth.unique[apart].all()


def test_boxes_with_parallel_axes():
    first, second = np.array([1.0, 0.5, 2.0]), np.array([0.4, 1.5, 0.2])
    t = offsets(500, 1.5)
    truth = Truths([box(2 * first)], [box(2 * second)], np.eye(3)).at(t)
    beyond = np.abs(t) - first - second
    expected = np.linalg.norm(beyond.clip(min=0), axis=1) + beyond.max(axis=1).clip(max=0)
    np.testing.assert_allclose(truth.distance, expected, rtol=0, atol=1e-14)
    # Faces lie against faces and edges along edges; only where three axes part them are vertices nearest.
    np.testing.assert_array_equal(truth.unique[expected > 0], (beyond > 0).all(axis=1)[expected > 0])


def test_capsules_that_cross_overlap_by_both_radii():
    a, b = capsule(0.1, [-1, 0, 0], [1, 0, 0]), capsule(0.2, [0, -1, 0], [0, 1, 0])
    truth = Truths([a], [b], np.eye(3)).at(np.array([[0, 0, 0.5], [0, 0, 1e-9], [0.3, 0.2, 0], [3.0, 0, 0]]))
    np.testing.assert_allclose(truth.distance, [0.2, 1e-9 - 0.3, -0.3, 1.7], rtol=0, atol=1e-15)
    np.testing.assert_allclose(np.abs(truth.normal[:3]), [[0, 0, 1]] * 3, rtol=0, atol=1e-15)
    np.testing.assert_allclose(truth.point_b[0], [0, 0, 0.3], rtol=0, atol=1e-15)
    # Along each other there is no one point, and at the same place no one direction; all are perpendicular.
    along = Truths([a], [a], np.eye(3)).at(np.array([[0.5, 0, 0.5], [0.5, 0, 0], [3.0, 0, 0]]))
    np.testing.assert_allclose(along.distance, [0.3, -0.2, 0.8], rtol=0, atol=1e-15)
    assert along.normal[1, 0] == 0 and along.unique.tolist() == [False, False, True]


def test_edges_that_cross():
    a, b = box([2, 2, 2]), box([2, 2, 2])
    # An edge of each body along y and along x, at height 1.
    R = (Rotation.from_euler("x", 45, degrees=True) * Rotation.from_euler("z", 90, degrees=True)).as_matrix()
    tilt = Rotation.from_euler("y", 45, degrees=True).as_matrix()
    height = 2 * np.sqrt(2.0)
    for gap in (0.3, 1e-7, 1e-12, 0.0, -1e-3):
        truth = Truths([hull(a.vertices @ tilt.T)], [b], R).at(np.array([[0.2, -0.1, height + gap]]))
        assert truth.distance[0] == pytest.approx(gap, abs=1e-15)
        np.testing.assert_allclose(truth.normal[0], [0, 0, 1], atol=1e-3 if gap == 1e-12 else 1e-8)
        np.testing.assert_allclose(truth.point_a[0], [0, -0.1, np.sqrt(2.0)], rtol=0, atol=1e-8)
        assert truth.unique[0] and truth.slide[0] < 10


@pytest.mark.parametrize("kind", ["ball", "box", "needle", "plate", "duplicates", "near-duplicates", "slivers"])
def test_no_direction_shows_more_and_the_points_prove_it(kind: Kind):
    for k, (first, second) in enumerate(make_pairs(kind, 1.0, 0).pairs):
        (a,), (b,) = first.pieces, second.pieces
        R = turned(k)
        t = offsets(60, 0.25) + a.vertices.mean(axis=0) - R @ b.vertices.mean(axis=0)
        truth = Truths([a], [b], R).at(t)
        # What two pieces are apart along a unit vector is never more than the truth, and along the normal it is that.
        certain = parted(a, b, R, t, truth.normal)
        np.testing.assert_allclose(certain, truth.distance, rtol=0, atol=1e-13)
        directions = np.concatenate([RNG.normal(size=(2000, 3)), truth.normal + 1e-4 * RNG.normal(size=(60, 3))])
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        for i in range(0, 60, 6):
            at_i = np.broadcast_to(t[i], directions.shape)
            assert parted(a, b, R, at_i, directions).max() <= truth.distance[i] + 1e-13
        # The points are on the pieces, and so far apart.
        one = truth.unique
        between = truth.point_b - truth.point_a
        np.testing.assert_allclose(between[one], (truth.distance[:, None] * truth.normal)[one], rtol=0, atol=1e-13)
        # Any of the vertices that are nearly one may stand for them.
        allowed = 1e-6 if kind == "near-duplicates" else 1e-13
        assert outside(a, truth.point_a[one]).max(initial=0) < allowed
        assert outside(b, moved(R, t, truth.point_b)[one]).max(initial=0) < allowed
