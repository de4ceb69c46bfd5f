"""Signed lower bounds: what they bound, where they are sharp, and that nothing is lost at the edge cases."""

from dataclasses import replace

import numpy as np
import pytest

from grasp_refine.collision.broadphase import Bounds, bounds_of, box_bound, sphere_bound
from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.se3 import exp_so3, inverse
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import Piece, box, capsule, hull, sphere
from shapes_for_tests import ellipsoid_hull
from twists import random_poses

TURNED = np.eye(4)
TURNED[:3, :3] = exp_so3(np.array([0.4, -1.1, 0.7]))

PIECES = {
    "sphere": sphere(0.02, [0.01, -0.02, 0.03]),
    "capsule": capsule(0.01, [0.02, 0, 0], [0.02, 0.05, -0.03]),
    "box": box([0.06, 0.01, 0.03], TURNED),
    "hull": ellipsoid_hull(0).transformed(TURNED),
    "rounded hull": Piece(ellipsoid_hull(1, 30).vertices, ellipsoid_hull(1, 30).faces, radius=0.015),
}


def surface_points(piece: Piece, count: int = 300) -> np.ndarray:
    """Points of the piece that are extreme in random directions."""
    u = np.random.default_rng(0).normal(size=(count, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return piece.vertices[(u @ piece.vertices.T).argmax(axis=1)] + piece.radius * u


def relative(T_a: np.ndarray, T_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    T = inverse(T_a) @ T_b
    return T[..., :3, :3], T[..., :3, 3]


@pytest.mark.parametrize("name", PIECES)
def test_balls_and_boxes_hold_the_whole_piece(name: str) -> None:
    piece = PIECES[name]
    bounds, points = bounds_of([piece]), surface_points(PIECES[name])
    center, axes, half = bounds.center[..., 0], bounds.axes[..., 0], bounds.half[..., 0]
    assert np.linalg.norm(points - center, axis=1).max() <= bounds.radius[0] * (1 + 1e-12)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    along = np.abs((points - center) @ axes.T)
    assert (along <= half * (1 + 1e-12)).all()
    # Touched on all sides: the box is no larger than it must be.
    extremes = piece.vertices @ axes.T
    np.testing.assert_allclose(np.ptp(extremes, axis=0) / 2 + piece.radius, half, rtol=1e-12)


def test_a_box_gets_its_own_sides_however_it_is_turned() -> None:
    np.testing.assert_allclose(np.sort(bounds_of([PIECES["box"]]).half[:, 0]), [0.005, 0.015, 0.03], atol=1e-12)


@pytest.mark.parametrize("b", PIECES)
@pytest.mark.parametrize("a", PIECES)
def test_bounds_never_exceed_the_signed_distance(a: str, b: str) -> None:
    bodies = [build_body(name, [PIECES[name]], candidates=16) for name in (a, b)]
    # Spread so that deep penetration, touch and separation all occur.
    T_a, T_b = random_poses(150, 1, 0.02), random_poses(150, 2, 0.04)
    distance = query(Pairs((bodies[0],), (bodies[1],)), T_a, T_b).distance[:, 0]
    assert (distance < 0).sum() > 10 and (distance > 0).sum() > 10
    R, t = relative(T_a[:, 0], T_b[:, 0])
    first = np.zeros(150, dtype=int)
    bounds_a, bounds_b = bounds_of([PIECES[a]]), bounds_of([PIECES[b]])
    boxes = box_bound(bounds_a.take(first), bounds_b.take(first), np.moveaxis(R, 0, -1), t.T)
    balls = sphere_bound(bounds_a.bounding_spheres, bounds_b.bounding_spheres, R, t)[0][:, 0, 0]
    # 1e-8 is the tolerance of EPA.
    assert (boxes <= distance + 1e-8).all() and (balls <= distance + 1e-8).all()
    # Not idle: apart, the better of the two is within the bodies' size of the truth.
    apart = distance > 0
    assert (np.maximum(balls, boxes)[apart] > distance[apart] - 0.08).all()


def test_the_ball_bound_of_spheres_is_their_distance() -> None:
    a, b = sphere(0.02, [0.01, 0, 0.02]), sphere(0.03, [0, -0.04, 0])
    T_a, T_b = random_poses(40, 3, 0.02), random_poses(40, 4, 0.03)
    R, t = relative(T_a[:, 0], T_b[:, 0])
    centers = [T[:, 0, :3, :3] @ p.vertices[0] + T[:, 0, :3, 3] for T, p in ((T_a, a), (T_b, b))]
    expected = np.linalg.norm(centers[1] - centers[0], axis=1) - 0.05
    assert (expected < 0).any() and (expected > 0).any()
    found, _ = sphere_bound(bounds_of([a]).bounding_spheres, bounds_of([b]).bounding_spheres, R, t)
    np.testing.assert_allclose(found[:, 0, 0], expected, atol=1e-15)


def test_ball_bounds_of_many_pieces_are_those_of_each_pair_and_padding_is_infinite() -> None:
    pieces = list(PIECES.values())
    rng = np.random.default_rng(8)
    padded = bounds_of(pieces)
    a = replace(padded.take(np.array([[0, 1, 2], [3, 4, 4]])), radius=np.array([[1, 2, 3], [4, 5, -np.inf]]) * 1e-2)
    b = replace(padded.take(np.array([[4, 3], [2, 1]])), radius=np.array([[1, 2], [-np.inf, 3]]) * 1e-2)
    R, t = exp_so3(rng.normal(size=(7, 2, 3))), rng.normal(size=(7, 2, 3)) * 0.1
    found, likeliest = sphere_bound(a.bounding_spheres, b.bounding_spheres, R, t)
    assert found.shape == (7, 2, 3, 2) and likeliest.shape == (7, 2)
    for p, i, j in np.ndindex(2, 3, 2):
        between = np.linalg.norm(R[:, p] @ b.center[:, p, j] + t[:, p] - a.center[:, p, i], axis=1)
        np.testing.assert_allclose(found[:, p, i, j], between - a.radius[p, i] - b.radius[p, j], atol=1e-13)
    assert np.isinf(found[:, 1, 2]).all() and np.isinf(found[:, 1, :, 0]).all()
    assert (np.isfinite(found.reshape(7, 2, 6)) & (np.arange(6) == likeliest[..., None])).any(axis=2).all()


@pytest.mark.parametrize("away", [0.0, 1e-9, 1.0])
def test_ball_bounds_far_from_the_origin_are_never_too_high(away: float) -> None:
    """One product cancels |x|^2 + |y|^2 where the centres are close: rounding must only lower the bound."""
    at = np.array([70.0, -50.0, 90.0])
    directions = np.random.default_rng(9).normal(size=(200, 3))
    shift = away * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    found, _ = sphere_bound(
        bounds_of([sphere(1e-3, at)]).bounding_spheres,
        bounds_of([sphere(1e-3, at)]).bounding_spheres,
        np.eye(3)[None],
        shift,
    )
    true = np.linalg.norm((at + shift) - at, axis=1) - 2e-3
    assert (found[:, 0, 0] <= true + 1e-15).all()
    # 16 ulps of the squared distance to the origin.
    assert (found[:, 0, 0] >= true - 2e-5).all()


@pytest.mark.parametrize("gap", [0.02, -0.003])
def test_the_box_bound_of_boxes_face_to_face_is_their_distance(gap: float) -> None:
    # In the frame of a: b lies beyond its +y side, turned about y by any angle.
    piece_a, piece_b = box([0.06, 0.02, 0.1]), box([0.03, 0.05, 0.08])
    turn = exp_so3(np.array([0.0, 0.6, 0.0]))[None]
    t = np.array([[0.005, 0.01 + 0.025 + gap, -0.01]])
    found = box_bound(bounds_of([piece_a]), bounds_of([piece_b]), np.moveaxis(turn, 0, -1), t.T)
    np.testing.assert_allclose(found, gap, atol=1e-15)


def test_coincident_centres_give_finite_bounds() -> None:
    piece = PIECES["hull"]
    bounds = bounds_of([piece])
    balls, _ = sphere_bound(bounds.bounding_spheres, bounds.bounding_spheres, np.eye(3)[None], np.zeros((1, 3)))
    assert balls[0, 0, 0] == pytest.approx(-2 * bounds.radius[0])
    found = box_bound(bounds, bounds, np.eye(3)[..., None], np.zeros((3, 1)))
    # No translation shorter than the smallest width separates a set from itself, and none longer is needed.
    assert found[0] == pytest.approx(-2 * bounds.half[0].min(), rel=1e-9)


def test_take_works_in_any_shape() -> None:
    bounds = bounds_of(list(PIECES.values()))
    taken = bounds.take(np.array([[0, 3], [2, 2]]))
    assert isinstance(taken, Bounds) and taken.axes.shape == (3, 3, 2, 2)
    np.testing.assert_array_equal(taken.center[:, 1, 0], bounds.center[:, 2])
    np.testing.assert_array_equal(taken.half[:, 0, 1], bounds.half[:, 3])


def test_flat_pieces_have_boxes_of_their_thickness() -> None:
    sheet = hull(np.random.default_rng(5).uniform(-1, 1, (40, 3)) * [0.05, 0.04, 1e-4])
    assert bounds_of([sheet]).half[0].min() < 1.2e-4
