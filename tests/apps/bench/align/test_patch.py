"""The patch witness: closed forms, what epsilon allows, continuity in the poses, and that it is never worse."""

from dataclasses import fields

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.core.se3 import exp_so3, inverse, tangents, transform, transform_points
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import Piece, box, cylinder, hull
from grasp_refine_apps.bench.align.patch import Patch
from shapes_for_tests import convex_body, ring_body

EPSILON = Patch().epsilon
BASE = box([0.06, 0.05, 0.04])
"""Its top is at z = 0.02."""
BLOCK = box([0.03, 0.02, 0.02])
Z = np.array([0.0, 0.0, 1.0])


def body(piece: Piece) -> Body:
    return build_body("body", [piece], candidates=32)


def num_queries(a: Body, b: Body, T_a: np.ndarray, T_b: np.ndarray) -> tuple[Pairs, Witness]:
    """The plain witness of one pair at M poses, as M items."""
    pairs = Pairs((a,), (b,))
    w = query(pairs, T_a[:, None], T_b[:, None])
    return pairs, Witness(*(getattr(w, field.name)[:, 0] for field in fields(w)))


def refined(
    a: Body, b: Body, T_a: np.ndarray, T_b: np.ndarray, t_a: np.ndarray | None, t_b: np.ndarray | None
) -> tuple[Witness, Witness]:
    """Plain and patch witness of one pair at M poses."""
    pairs, w = num_queries(a, b, T_a, T_b)
    return w, Patch().refine(pairs, T_a, T_b, w, t_a, t_b)


def still(count: int) -> np.ndarray:
    return np.broadcast_to(np.eye(4), (count, 4, 4)).copy()


def placed(R: np.ndarray, position: np.ndarray) -> np.ndarray:
    return transform(R, np.broadcast_to(position, (len(R), 3)).astype(np.float64))


def stacked(tilt: np.ndarray, axis: tuple[float, float, float] = (0.6, 0.8, 0.0), gap: float = 1e-3) -> np.ndarray:
    """Poses of BLOCK on BASE, so that the faces overlap for x in (0.01, 0.03) and y in (0, 0.02) at tilt zero."""
    return placed(exp_so3(tilt[:, None] * np.array(axis)), np.array([0.025, 0.01, 0.03 + gap]))


def seen_from_b(T_b: np.ndarray, target: np.ndarray) -> np.ndarray:
    return transform_points(inverse(T_b), target)


def misses(w: Witness, T_a: np.ndarray, T_b: np.ndarray, t_a: np.ndarray, t_b: np.ndarray) -> np.ndarray:
    a, b = w.point_a - transform_points(T_a, t_a), w.point_b - transform_points(T_b, t_b)
    return (a**2).sum(axis=1) + (b**2).sum(axis=1)


def same(first: Witness, second: Witness) -> bool:
    return all(np.array_equal(getattr(first, f.name), getattr(second, f.name), equal_nan=True) for f in fields(first))


def depth_outside(piece: Piece, T: np.ndarray, x: np.ndarray) -> np.ndarray:
    """How far points (M, 3) of a piece at poses T lie outside of its core; negative inside."""
    normals, offsets = piece.planes
    return (transform_points(inverse(T), x) @ normals.T - offsets).max(axis=1)


def random_poses(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Two bodies in any orientation, apart or not."""
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    R_a, R_b = exp_so3(rng.normal(size=(count, 3)) * 2), exp_so3(rng.normal(size=(count, 3)) * 2)
    T_a = transform(R_a, rng.normal(size=(count, 3)) * 0.1)
    return T_a, transform(R_b, T_a[:, :3, 3] + direction * rng.uniform(0.02, 0.12, (count, 1)))


def planted(rng: np.random.Generator, points: int = 20, corners: int = 6) -> Piece:
    """A random hull that ends in a flat face at z = 0.02."""
    cloud = rng.normal(size=(points, 3)) * [0.02, 0.02, 0.008] - [0, 0, 0.01]
    cloud[:, 2] = np.minimum(cloud[:, 2], 0.015)
    rim = np.concatenate([rng.normal(size=(corners, 2)) * 0.015, np.full((corners, 1), 0.02)], axis=1)
    return hull(np.concatenate([cloud, rim]))


def face_to_face(rng: np.random.Generator, count: int, tilt: float, gap: float) -> tuple[np.ndarray, np.ndarray]:
    """Poses of two planted pieces whose flat faces look at each other across a gap, nearly parallel."""
    T_a, _ = random_poses(rng, count)
    spin = exp_so3(rng.uniform(0, 2 * np.pi, (count, 1)) * Z)
    lean = exp_so3(rng.normal(size=(count, 3)) * [tilt, tilt, 0])
    flip = exp_so3(np.array([np.pi, 0.0, 0.0]))
    position = np.concatenate([rng.uniform(-0.008, 0.008, (count, 2)), np.full((count, 1), 0.04 + gap)], axis=1)
    return T_a, T_a @ transform(lean @ spin @ flip, position)


# closed forms


@pytest.mark.parametrize("gap", [1e-2, 1e-3, 1e-6, -1e-6, -1e-3])
def test_box_on_box_gives_the_point_of_the_overlap_nearest_to_the_target(gap: float):
    goal = np.array([[0.02, 0.01], [0.011, 0.019], [0.05, 0.01], [0.05, 0.06], [-0.02, -0.01], [0.015, -0.1]])
    target = np.concatenate([goal, np.full((6, 1), 0.02)], axis=1)
    T_a, T_b = still(6), stacked(np.zeros(6), gap=gap)
    plain, patch = refined(body(BASE), body(BLOCK), T_a, T_b, target, seen_from_b(T_b, target))
    expected = np.clip(target, [0.01, 0.0, 0.02], [0.03, 0.02, 0.02])
    np.testing.assert_allclose(patch.point_a, expected, atol=1e-10)
    np.testing.assert_allclose(patch.point_b, expected + gap * Z, atol=1e-10)
    np.testing.assert_allclose(patch.distance, gap, atol=1e-10)
    np.testing.assert_array_equal(patch.normal, plain.normal)
    np.testing.assert_array_equal(patch.status, plain.status)


def test_a_tilt_beyond_epsilon_leaves_the_strip_that_epsilon_allows():
    tilt = np.array([1e-3])
    T_a, T_b = still(1), placed(exp_so3(tilt[:, None] * [0.0, 1.0, 0.0]), np.array([0.0, 0.0, 0.031]))
    target = np.array([[-0.03, 0.0, 0.02]])
    plain, patch = refined(body(BASE), body(BLOCK), T_a, T_b, target, seen_from_b(T_b, target))
    # Turned about +y, the block is lowest at +x; its lower face rises by sin(tilt) a metre towards -x.
    lowest = transform_points(T_b, np.array([[0.015, 0.0, -0.01]]))[0, 0]
    np.testing.assert_allclose(plain.point_a[0, 0], lowest, atol=1e-9)
    np.testing.assert_allclose(patch.point_a[0, 0], lowest - EPSILON / np.tan(1e-3), atol=1e-8)
    np.testing.assert_allclose(patch.distance - plain.distance, EPSILON, atol=1e-10)


def test_the_radius_of_a_rounded_polytope_is_added_along_the_normal():
    round_block = Piece(BLOCK.vertices, BLOCK.faces, radius=0.004)
    target = np.array([[0.02, 0.01, 0.02], [0.05, 0.06, 0.02]])
    T_a, T_b = still(2), stacked(np.zeros(2), gap=0.005)
    for bodies, up in (((BASE, round_block), True), ((round_block, BASE), False)):
        poses = (T_a, T_b) if up else (T_b, T_a)
        targets = (target, seen_from_b(T_b, target)) if up else (seen_from_b(T_b, target), target)
        _, patch = refined(*(body(piece) for piece in bodies), *poses, *targets)
        np.testing.assert_allclose(patch.distance, 0.001, atol=1e-10)
        low, high = (patch.point_a, patch.point_b) if up else (patch.point_b, patch.point_a)
        np.testing.assert_allclose(low, [[0.02, 0.01, 0.02], [0.03, 0.02, 0.02]], atol=1e-10)
        np.testing.assert_allclose(high, low + 0.001 * Z, atol=1e-10)


# what epsilon allows


def test_a_vertex_on_a_face_keeps_its_witness_bit_for_bit():
    corner = exp_so3(np.array([0.7, 0.0, 0.0])) @ exp_so3(np.array([0.0, 0.6, 0.0]))
    T_a, T_b = still(1), placed(corner[None], np.array([0.0, 0.0, 0.05]))
    target = np.array([[0.02, 0.02, 0.02]])
    assert same(*refined(body(BASE), body(BLOCK), T_a, T_b, target, seen_from_b(T_b, target)))


BODIES = {
    "boxes": lambda: (body(BASE), body(BLOCK)),
    "hulls": lambda: (convex_body(0), convex_body(1)),
    "prism": lambda: (body(cylinder(0.02, 0.05)), body(BLOCK)),
    "rings": lambda: (ring_body(), ring_body(1)),
}


@pytest.mark.parametrize("name", BODIES)
def test_at_random_poses_it_is_never_worse_and_stays_within_epsilon(name: str):
    rng = np.random.default_rng(3)
    a, b = BODIES[name]()
    T_a, T_b = random_poses(rng, 300)
    t_a, t_b = rng.normal(size=(2, 300, 3)) * 0.02
    plain, patch = refined(a, b, T_a, T_b, t_a, t_b)
    assert (misses(patch, T_a, T_b, t_a, t_b) <= misses(plain, T_a, T_b, t_a, t_b) * (1 + 1e-14)).all()
    assert (patch.distance >= plain.distance - 1e-7).all()
    assert (patch.distance <= plain.distance + EPSILON * (1 + 1e-5)).all()
    offset = patch.point_b - patch.point_a
    np.testing.assert_allclose(offset, patch.distance[:, None] * patch.normal, atol=1e-12)
    for w, T, pieces, x in ((patch, T_a, a.pieces, patch.point_a), (patch, T_b, b.pieces, patch.point_b)):
        outside = np.min([depth_outside(piece, T, x) for piece in pieces], axis=0)
        assert outside[w.valid].max() < 1e-7
    assert (patch.point_a != plain.point_a).any(axis=1).mean() > 0.1


# the definition


def brute_force(a: Piece, b: Piece, T_a: np.ndarray, T_b: np.ndarray, w: Witness, goal: np.ndarray) -> np.ndarray:
    """The point of the patch nearest to `goal` by a general solver: minimise over (p, h_a, h_b) for one item."""
    x_a, x_b, n = w.point_a[0], w.point_b[0], w.normal[0]
    E = tangents(n)
    frame = np.concatenate([E, n[:, None]], axis=1)
    rows, right = [], []
    for piece, T, x, column in ((a, T_a, x_a, 2), (b, T_b, x_b, 3)):
        normals, offsets = piece.planes
        world = normals @ T[:3, :3].T
        local = world @ frame
        block = np.zeros((len(local), 4))
        block[:, :2], block[:, column] = local[:, :2], local[:, 2]
        rows.append(block)
        right.append(offsets + world @ T[:3, 3] - world @ x)
    rows.append(np.array([[0.0, 0.0, -1.0, 1.0]]))
    right.append(np.array([EPSILON]))
    A, o, g = np.concatenate(rows), np.concatenate(right), E.T @ (goal - x_a)
    # In millimetres across and epsilon along, which a general solver can handle.
    A, o, g = A * [1e-3, 1e-3, EPSILON, EPSILON], o, g / 1e-3
    scale = np.linalg.norm(A, axis=1)
    A, o = A / scale[:, None], o / scale
    inside = linprog(np.zeros(4), A_ub=A, b_ub=o, bounds=(None, None)).x
    found = minimize(
        lambda x: ((x[:2] - g) ** 2).sum(),
        inside,
        jac=lambda x: np.concatenate([2 * (x[:2] - g), [0, 0]]),
        constraints={"type": "ineq", "fun": lambda x: o - A @ x, "jac": lambda x: -A},
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-14},
    )
    return x_a + E @ (found.x[:2] * 1e-3)


@pytest.mark.parametrize("tilt", [0.0, 1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("gap", [1e-3, -1e-3])
def test_planted_faces_agree_with_a_general_solver(tilt: float, gap: float):
    rng = np.random.default_rng(7)
    for _ in range(4):
        a, b = planted(rng), planted(rng)
        T_a, T_b = face_to_face(rng, 5, tilt, gap)
        goal = transform_points(T_a, rng.normal(size=(5, 3)) * [0.015, 0.015, 0] + [0, 0, 0.02])
        t_a, t_b = transform_points(inverse(T_a), goal), transform_points(inverse(T_b), goal)
        plain, patch = refined(body(a), body(b), T_a, T_b, t_a, t_b)
        for i in range(5):
            one = plain.rows(np.array([i]))
            expected = brute_force(a, b, T_a[i], T_b[i], one, goal[i])
            across = tangents(one.normal[0]).T @ (patch.point_a[i] - expected)
            assert np.linalg.norm(across) < 2e-6
