"""Alignment tasks: targets on the surface, aligned poses that align, and witness points that say what can touch."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.se3 import exp_se3, matvec, transform_points
from grasp_refine.geometry.body import Body
from grasp_refine_apps.bench.align import tasks as module
from grasp_refine_apps.bench.align.bodies import BodyPair, normalised
from grasp_refine_apps.bench.align.tasks import (
    ACCEPTED_MISS_M,
    CLASSES,
    REACHABLE_MISS_M,
    Tasks,
    aligned_poses,
    draw_tasks,
    exposed_vertices,
    points_on_faces,
)
from shapes_for_tests import cluster_body, convex_body, ring_body

CONVEX = BodyPair("hulls", "convex", normalised(convex_body(1, 24), 0.06), normalised(convex_body(2, 24), 0.11))
CONCAVE = BodyPair("ring and cluster", "concave", normalised(ring_body(), 0.12), normalised(cluster_body(3, 4), 0.15))
PLAIN = CLASSES[:3]
VERTEX, FACE = 1e-12, 1e-9


def bodies(pair: BodyPair) -> tuple[Body, Body]:
    return pair.a, pair.b


def to_vertices(body: Body, points: np.ndarray) -> np.ndarray:
    """Distance (N,) of points (N, 3) to the nearest vertex of a piece."""
    vertices = np.concatenate([piece.vertices for piece in body.pieces])
    return np.linalg.norm(points[:, None] - vertices, axis=-1).min(axis=1)


def depths(body: Body, points: np.ndarray) -> np.ndarray:
    """Largest plane distance (N, P) of points (N, 3) to each piece: 0 on its surface, negative inside."""
    return np.stack([(points @ n.T - offset).max(axis=1) for n, offset in (p.planes for p in body.pieces)], axis=1)


def drawn(pair: BodyPair, classes: tuple[str, ...] = PLAIN, count: int = 24, seed: int = 0) -> Tasks:
    return draw_tasks(pair, classes, count, seed)


def unit(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.fixture(scope="module", params=[CONVEX, CONCAVE], ids=["convex", "concave"])
def task_set(request: pytest.FixtureRequest) -> tuple[BodyPair, Tasks]:
    """A pair, and its tasks of all classes."""
    return request.param, drawn(request.param, CLASSES, 80)


# Aligned poses


def test_aligned_poses_put_the_targets_on_each_other_with_opposite_normals():
    rng = np.random.default_rng(0)
    N = 50
    T_a = exp_se3(rng.normal(size=(N, 6)))
    t_a, t_b, n_a, n_b = rng.normal(size=(N, 3)), rng.normal(size=(N, 3)), unit(rng, N), unit(rng, N)
    # The axes are where bases of tangents are discontinuous.
    n_a[:3], n_b[:3], n_a[3], n_b[3] = np.eye(3), -np.eye(3), [0, 0, -1], [0, 0, -1]
    T_b = aligned_poses(T_a, (t_a, n_a), (t_b, n_b), rng.uniform(0, 2 * np.pi, N))
    np.testing.assert_allclose(transform_points(T_b, t_b), transform_points(T_a, t_a), atol=1e-12)
    np.testing.assert_allclose(matvec(T_b[:, :3, :3], n_b), -matvec(T_a[:, :3, :3], n_a), atol=1e-12)
    np.testing.assert_allclose(T_b[:, :3, :3] @ T_b[:, :3, :3].mT, np.broadcast_to(np.eye(3), (N, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(T_b[:, :3, :3]), 1.0)
    np.testing.assert_array_equal(T_b[:, 3], np.broadcast_to([0.0, 0, 0, 1], (N, 4)))


# Targets


def test_exposed_vertices_of_a_hull_are_all_of_them_with_outward_normals():
    points, normals = exposed_vertices(CONVEX.a)
    (piece,) = CONVEX.a.pieces
    assert len(points) == len(piece.vertices)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    # The normal is one at which the hull has its vertex: most of the body lies behind it.
    k = int(np.argmax(points[:, 0]))
    around = piece.faces[(piece.vertices[piece.faces] == points[k]).all(axis=-1).any(axis=-1)]
    a, b, c = (piece.vertices[around[:, i]] for i in range(3))
    total = np.cross(b - a, c - a).sum(axis=0)
    np.testing.assert_allclose(normals[k], total / np.linalg.norm(total), atol=1e-12)
    assert (np.einsum("ni,ni->n", points, normals) > 0).all()


def test_points_on_faces_are_drawn_evenly():
    points, normals = points_on_faces(CONVEX.a, 4000, np.random.default_rng(0))
    assert len(points) == 4000
    (piece,) = CONVEX.a.pieces
    corners = piece.vertices[piece.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    center = corners.mean(axis=1)
    mean = (area[:, None] * center).sum(axis=0) / area.sum()
    spread = points.std(axis=0) / np.sqrt(len(points))
    assert (np.abs(points.mean(axis=0) - mean) < 5 * spread).all()
    drawn_area = [np.isclose(normals @ normal, 1.0, atol=1e-12).mean() for normal in piece.normals]
    np.testing.assert_allclose(drawn_area, area / area.sum(), atol=5 * np.sqrt(0.25 / len(points)))


def test_targets_lie_on_vertices_and_on_exposed_faces(task_set: tuple[BodyPair, Tasks]):
    pair, tasks = task_set
    for side, (body, targets) in enumerate(zip(bodies(pair), (tasks.target_a, tasks.target_b), strict=True)):
        vertex = np.array([CLASSES[index].split("-")[side] == "vertex" for index in tasks.target_class])
        assert vertex.any() and not vertex.all()
        depth = depths(body, targets)
        # In the plane of a face, and inside no piece.
        assert np.abs(depth).min(axis=1).max() < FACE
        assert depth.min() > -FACE
        assert to_vertices(body, targets[vertex]).max() < VERTEX
        assert (to_vertices(body, targets[~vertex]) > 1e-6).all()


# What can touch


class Recorded:
    """All tasks that were drawn on the way, and the aligned pose of each."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.tasks: list[Tasks] = []
        self.T_aligned: list[np.ndarray] = []
        draw, place = module._draw, module.aligned_poses

        def drawn(*arguments: Any) -> Tasks:
            self.tasks.append(draw(*arguments))
            return self.tasks[-1]

        def placed(*arguments: Any) -> np.ndarray:
            self.T_aligned.append(place(*arguments))
            return self.T_aligned[-1]

        monkeypatch.setattr(module, "_draw", drawn)
        monkeypatch.setattr(module, "aligned_poses", placed)

    def all(self) -> Tasks:
        return Tasks(*(np.concatenate([getattr(one, field.name) for one in self.tasks]) for field in fields(Tasks)))


@pytest.mark.parametrize("pair", [CONVEX, CONCAVE], ids=["convex", "concave"])
def test_the_witness_points_at_the_aligned_pose_decide(pair: BodyPair, monkeypatch: pytest.MonkeyPatch):
    recorded = Recorded(monkeypatch)
    draw_tasks(pair, CLASSES, 12, 4)
    tasks, T_aligned = recorded.all(), np.concatenate(recorded.T_aligned)
    pairs, miss = Pairs((pair.a,), (pair.b,)), []
    for t_a, t_b, T_b in zip(tasks.target_a, tasks.target_b, T_aligned, strict=True):
        found = query(pairs, np.eye(4)[None, None], T_b[None, None])
        in_b = (found.point_b[0, 0] - T_b[:3, 3]) @ T_b[:3, :3]
        miss.append(np.hypot(np.linalg.norm(found.point_a[0, 0] - t_a), np.linalg.norm(in_b - t_b)))
        np.testing.assert_allclose(T_b[:3, :3] @ t_b + T_b[:3, 3], t_a, atol=1e-12)
    np.testing.assert_array_equal(tasks.accepted, np.array(miss) < ACCEPTED_MISS_M)
    np.testing.assert_array_equal(tasks.reachable, np.array(miss) < REACHABLE_MISS_M)
    assert tasks.accepted.any() and not tasks.accepted.all()


def test_initial_poses_are_random_and_apart_as_documented():
    tasks = drawn(CONVEX, PLAIN, 600)
    np.testing.assert_array_equal(tasks.T_world_a, np.broadcast_to(np.eye(4), tasks.T_world_a.shape))
    R, p = tasks.T_world_b[:, :3, :3], tasks.T_world_b[:, :3, 3]
    np.testing.assert_allclose(R @ R.mT, np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    # A rotation drawn evenly has mean 0 and entries of variance 1/3; so has a direction.
    tolerance = 5 * np.sqrt(1 / 3 / len(tasks))
    assert np.abs(R.mean(axis=0)).max() < tolerance
    away = np.linalg.norm(p, axis=1) / (0.5 * (CONVEX.a.diagonal + CONVEX.b.diagonal))
    assert 0.5 <= away.min() < 0.52 and 1.48 < away.max() <= 1.5
    assert np.abs((p / np.linalg.norm(p, axis=1, keepdims=True)).mean(axis=0)).max() < tolerance
    found = query(Pairs((CONVEX.a,), (CONVEX.b,)), tasks.T_world_a[:, None], tasks.T_world_b[:, None])
    assert 0.0 < (found.distance < 0).mean() < 0.6
