"""Neighbourhoods: who belongs to them, how wide they are, and that chance is seeded and nobody else's business."""

import numpy as np
import pytest

from grasp_refine.collision.query import Pairs, query
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import box
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.neighborhood import Adaptive, Fixed, Neighbors, Surfaces, choose, distance_from, draw_offset
from grasp_refine.witness.scene import WitnessScene
from shapes_for_tests import convex_body, ring_body
from twists import poses_at_gap

BODIES: tuple[Body, ...] = (convex_body(0), ring_body(1), build_body("box", [box([0.1, 0.06, 0.02])]))


@pytest.fixture(scope="module")
def surfaces() -> Surfaces:
    return Surfaces.of(BODIES)


def witnesses(surfaces: Surfaces, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Points near the surfaces (S, count, 3), with the normals there."""
    rng = np.random.default_rng(seed)
    index = rng.integers(surfaces.points.shape[1], size=(len(surfaces.points), count))
    rows = np.arange(len(surfaces.points))[:, None]
    x = surfaces.points[rows, index] + rng.normal(size=(*index.shape, 3)) * 1e-4
    return x, surfaces.normals[rows, index]


def members(surfaces: Surfaces, s: int, x: np.ndarray, normal: np.ndarray, radius: float) -> np.ndarray:
    """The candidates that belong to one neighbourhood, found one by one."""
    close = np.linalg.norm(surfaces.points[s] - x, axis=1) <= radius
    return np.flatnonzero(close & (surfaces.normals[s] @ normal >= -0.5))


def index_of(surfaces: Surfaces, s: int, near: Neighbors, b: int) -> np.ndarray:
    """Which candidates were chosen for item b of body s."""
    chosen = near.points[s, b, 1:][near.mask[s, b, 1:]]
    away = np.abs(surfaces.points[s][None] - chosen[:, None]).max(axis=2)
    assert (away.min(axis=1) == 0.0).all(), "only candidates are chosen"
    return away.argmin(axis=1)


def test_all_candidates_within_the_radius_whose_normals_agree_are_chosen(surfaces: Surfaces) -> None:
    x, normal = witnesses(surfaces, 8, seed=1)
    near = choose(Adaptive(samples=None, without_target=6.0), surfaces, x, normal, None, 0)
    for s in range(len(BODIES)):
        for b in range(8):
            expected = members(surfaces, s, x[s, b], normal[s, b], 6.0 * surfaces.spacing[s])
            if len(expected) >= 8:
                np.testing.assert_array_equal(np.sort(index_of(surfaces, s, near, b)), expected)
    # The wall of the ring is 2.5 cm thick and the sheet 2 cm: both sides were within reach.
    opposite = [
        np.linalg.norm(surfaces.points[2] - x[2, b], axis=1)[surfaces.normals[2] @ normal[2, b] < -0.5].min()
        for b in range(8)
    ]
    assert min(opposite) < 6.0 * surfaces.spacing[2]


def test_the_witness_comes_first_and_has_no_normal_of_its_own(surfaces: Surfaces) -> None:
    x, normal = witnesses(surfaces, 5, seed=2)
    near = choose(Adaptive(), surfaces, x, normal, None, 0)
    np.testing.assert_array_equal(near.points[:, :, 0], x)
    assert near.mask[:, :, 0].all()
    assert near.points.shape == (3, 5, 17, 3) and near.normals.shape == (3, 5, 16, 3)
    for s in range(3):
        for b in range(5):
            index = index_of(surfaces, s, near, b)
            np.testing.assert_array_equal(near.normals[s, b][near.mask[s, b, 1:]], surfaces.normals[s, index])


def test_a_few_are_drawn_from_the_members_and_others_at_another_time(surfaces: Surfaces) -> None:
    x, normal = witnesses(surfaces, 10, seed=3)
    rule, drawn = Fixed(0.3), []
    for key in range(4):
        near = choose(rule, surfaces, x, normal, None, draw_offset(0, key))
        again = choose(rule, surfaces, x, normal, None, draw_offset(0, key))
        np.testing.assert_array_equal(near.points, again.points)
        for s in range(3):
            for b in range(10):
                found = index_of(surfaces, s, near, b)
                assert len(np.unique(found)) == len(found) >= 8
                expected = members(surfaces, s, x[s, b], normal[s, b], 0.3 * surfaces.diagonal[s])
                assert set(found) <= set(expected)
        drawn.append(index_of(surfaces, 0, near, 0))
    assert len({tuple(sorted(row)) for row in drawn}) == 4


def test_with_too_few_inside_the_nearest_ones_are_taken(surfaces: Surfaces) -> None:
    x, normal = witnesses(surfaces, 10, seed=5)
    near = choose(Adaptive(without_target=1e-3), surfaces, x, normal, None, 0)
    assert (near.mask[:, :, 1:].sum(axis=2) == 8).all()
    for s in range(3):
        for b in range(10):
            agree = np.flatnonzero(surfaces.normals[s] @ normal[s, b] >= -0.5)
            order = agree[np.linalg.norm(surfaces.points[s, agree] - x[s, b], axis=1).argsort()]
            assert set(index_of(surfaces, s, near, b)) == set(order[:8])


def test_a_body_with_few_candidates_gives_all_it_has() -> None:
    surfaces = Surfaces.of([build_body("few", [box([0.1, 0.1, 0.1])], candidates=4)])
    x, normal = witnesses(surfaces, 3, seed=6)
    near = choose(Adaptive(), surfaces, x, normal, None, 3)
    assert np.isfinite(near.points).all() and (near.mask.sum(axis=2) <= 5).all()


def test_width_follows_the_target(surfaces: Surfaces) -> None:
    x, _ = witnesses(surfaces, 4, seed=7)
    target = x + np.array([0.0, 1e-5, 0.02, np.nan])[None, :, None] * [1.0, 0.0, 0.0]
    away = distance_from(target, x)
    eps = surfaces.spacing
    expected = np.stack([eps, eps, np.maximum(0.02, eps), 4 * eps], axis=1)
    np.testing.assert_allclose(Adaptive().radius(surfaces, away), expected)
    wider = np.stack([3 * eps, 3 * eps, np.maximum(0.02, 3 * eps), 4 * eps], axis=1)
    np.testing.assert_allclose(Adaptive(smallest=3.0).radius(surfaces, away), wider)
    np.testing.assert_allclose(np.broadcast_to(Adaptive().radius(surfaces, None), (3, 4)), expected[:, [3] * 4])
    fixed = np.broadcast_to(Fixed(0.2).radius(surfaces, away), (3, 4))
    np.testing.assert_allclose(fixed, 0.2 * surfaces.diagonal[:, None] * np.ones(4))
    np.testing.assert_allclose(
        np.broadcast_to(choose(Fixed(0.2), surfaces, x, x, target, 0).radius, (3, 4)), fixed, atol=0
    )


def test_targets_are_points_of_the_bodies_and_not_of_the_world() -> None:
    """The scene passes targets through as they are, and witness points in the frame of their body."""
    pairs = Pairs((convex_body(0),), (convex_body(1),))
    T_a, T_b = poses_at_gap(pairs, 3, 0.01, seed=9)
    w = query(pairs, T_a, T_b)
    local_a = np.einsum("bpji,bpj->bpi", T_a[..., :3, :3], w.point_a - T_a[..., :3, 3])
    local_b = np.einsum("bpji,bpj->bpi", T_b[..., :3, :3], w.point_b - T_b[..., :3, 3])
    columns = WitnessLayer(pairs, Distance()).columns(np.array([0]))
    sides = WitnessScene(*columns, T_a, T_b, w, local_a, None, 0).sides()
    np.testing.assert_allclose(sides.point[0], local_a[:, 0], atol=1e-15)
    np.testing.assert_allclose(sides.point[1], local_b[:, 0], atol=1e-15)
    np.testing.assert_allclose(sides.target[0], sides.point[0], atol=1e-15)
    assert np.isnan(sides.target[1]).all()
    # Outward on both sides, and the other's witness lies d along that normal.
    for s in range(2):
        np.testing.assert_allclose(sides.other[s], sides.point[s] + w.distance * sides.normal[s], atol=1e-12)
