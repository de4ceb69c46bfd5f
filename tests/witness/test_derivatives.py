"""Derivatives of the witness layer against finite differences and closed forms."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.errors import CollisionError
from grasp_refine.core.se3 import cross, exp_se3, inverse, matvec, transform_points
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import box, capsule, hull, sphere
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.distance import Distance, smooth, temperature
from grasp_refine.witness.neighborhood import Adaptive, Fixed
from grasp_refine.witness.rings import Neighbor
from grasp_refine.witness.scene import WitnessScene
from grasp_refine.witness.slip import Slip, pull_back, pull_back_witness, push_forward
from refusals import refused
from twists import (
    contracted,
    layer_gradient,
    poses_at_gap,
    random_cotangents,
    random_poses,
    slopes_along_twists,
)

POINTS = ("point_a", "point_b")
ALL = (*POINTS, "normal", "distance")


def rounded(seed: int, vertices: int = 300) -> Body:
    directions = np.random.default_rng(seed).normal(size=(vertices, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return build_body(f"hull {seed}", [hull(directions * [0.05, 0.03, 0.02])], seed=seed)


def concave(seed: int) -> Body:
    rng = np.random.default_rng(seed)
    pieces = [hull(rng.normal(size=(20, 3)) * 0.015 + center) for center in rng.normal(size=(5, 3)) * 0.04]
    return build_body(f"concave {seed}", pieces, seed=seed)


BODIES = {
    "hulls": lambda: (rounded(0), rounded(1)),
    "concave": lambda: (concave(2), concave(3)),
    "sphere and box": lambda: (build_body("s", [sphere(0.02)]), build_body("b", [box([0.05, 0.04, 0.03])])),
    "capsule and hull": lambda: (build_body("c", [capsule(0.01, (0, 0, -0.02), (0, 0, 0.03))]), rounded(4)),
}


# (a) the slip algebra with exact slips


@dataclass(frozen=True)
class ExactSpheres:
    """Slip of spheres about their bodies' origins: A = r / (r + d) (I - n n^T), exact apart and in penetration."""

    radius_a: float
    radius_b: float

    def pull_back(
        self, scene: WitnessScene, force_a: np.ndarray, force_b: np.ndarray, force_n: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        w = scene.witness
        across = np.eye(3) - w.normal[..., :, None] * w.normal[..., None, :]
        d = w.distance[..., None, None]
        A, B = (r / (r + d) * across for r in (self.radius_a, self.radius_b))
        return pull_back_witness(
            Slip(A, B, w.point_a, w.point_b, sampled=False), scene, force_a, force_b, force_n, "coupled"
        )


@pytest.mark.parametrize("gap", [0.02, 1e-4, -0.004])
def test_coupled_slip_of_spheres_is_exact(gap: float) -> None:
    pairs = Pairs((build_body("a", [sphere(0.03)]),), (build_body("b", [sphere(0.02)]),))
    T_a, T_b = poses_at_gap(pairs, 5, gap, seed=1)
    cotangents = random_cotangents(query(pairs, T_a, T_b), (*POINTS, "distance"), seed=2)
    expected = slopes_along_twists(lambda a, b: contracted(query(pairs, a, b), cotangents), T_a, T_b, 1e-5)
    found = layer_gradient(WitnessLayer(pairs, ExactSpheres(0.03, 0.02)), T_a, T_b, cotangents)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def closest_on_ellipsoids(T_a: np.ndarray, T_b: np.ndarray, axes_a: np.ndarray, axes_b: np.ndarray) -> np.ndarray:
    """Closest points (2, 3) of two separated ellipsoids, by Newton's method on the KKT conditions."""
    Q_a, Q_b = (T[:3, :3] @ np.diag(axes**-2.0) @ T[:3, :3].T for T, axes in ((T_a, axes_a), (T_b, axes_b)))
    c_a, c_b = T_a[:3, 3], T_b[:3, 3]
    away = c_b - c_a
    x = c_a + away / np.sqrt(away @ Q_a @ away)
    y = c_b - away / np.sqrt(away @ Q_b @ away)
    # Stationary points of |x - y|^2 / 2 + l (f(x) - 1) / 2 + m (g(y) - 1) / 2.
    gap = y - x
    lam, mu = (
        (gap @ Q_a @ (x - c_a)) / np.sum((Q_a @ (x - c_a)) ** 2),
        -(gap @ Q_b @ (y - c_b)) / np.sum((Q_b @ (y - c_b)) ** 2),
    )
    z = np.concatenate([x, y, [lam, mu]])
    for _ in range(60):
        x, y, lam, mu = z[:3], z[3:6], z[6], z[7]
        ga, gb = Q_a @ (x - c_a), Q_b @ (y - c_b)
        residual = np.concatenate(
            [x - y + lam * ga, y - x + mu * gb, [((x - c_a) @ ga - 1) / 2, ((y - c_b) @ gb - 1) / 2]]
        )
        J = np.zeros((8, 8))
        J[:3, :3], J[:3, 3:6], J[:3, 6] = np.eye(3) + lam * Q_a, -np.eye(3), ga
        J[3:6, :3], J[3:6, 3:6], J[3:6, 7] = -np.eye(3), np.eye(3) + mu * Q_b, gb
        J[6, :3], J[7, 3:6] = ga, gb
        step = np.linalg.solve(J, residual)
        z = z - step * min(1.0, 0.02 / np.abs(step[:6]).max())
        if np.abs(step).max() < 1e-14:
            break
    assert np.abs(residual).max() < 1e-12
    return z[:6].reshape(2, 3)


def ellipsoid_slip(T: np.ndarray, axes: np.ndarray, x: np.ndarray, outward: np.ndarray, d: float) -> np.ndarray:
    """A = (I + d K)^-1 P with the shape operator K = P H P / |grad f| of an ellipsoid at x."""
    Q = T[:3, :3] @ np.diag(axes**-2.0) @ T[:3, :3].T
    P = np.eye(3) - np.outer(outward, outward)
    K = P @ Q @ P / np.linalg.norm(Q @ (x - T[:3, 3]))
    return np.linalg.solve(np.eye(3) + d * K, P)


@pytest.mark.parametrize("seed", range(4))
def test_coupled_slip_of_ellipsoids_is_exact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axes_a, axes_b = rng.uniform(0.02, 0.05, 3), rng.uniform(0.02, 0.05, 3)
    T_a, T_b = random_poses(1, seed)[0, 0], random_poses(1, seed + 50)[0, 0]
    direction = rng.normal(size=3)
    T_b[:3, 3] = T_a[:3, 3] + 0.12 * direction / np.linalg.norm(direction)
    x, y = closest_on_ellipsoids(T_a, T_b, axes_a, axes_b)
    d = np.linalg.norm(y - x)
    n = (y - x) / d
    A, B = ellipsoid_slip(T_a, axes_a, x, n, d), ellipsoid_slip(T_b, axes_b, y, -n, d)
    slip = Slip(A, B, x, y, sampled=False)
    for _ in range(6):
        twist_a, twist_b = rng.normal(size=(2, 6))
        h = 1e-5
        ends = [
            closest_on_ellipsoids(exp_se3(s * h * twist_a) @ T_a, exp_se3(s * h * twist_b) @ T_b, axes_a, axes_b)
            for s in (1.0, -1.0)
        ]
        expected = (ends[0] - ends[1]) / (2 * h)
        np.testing.assert_allclose(np.stack(push_forward(slip, x, y, twist_a, twist_b)), expected, atol=1e-6)


@pytest.mark.parametrize("coupling", ["coupled", "one-sided"])
def test_pull_back_is_the_transpose_of_push_forward(coupling: str) -> None:
    rng = np.random.default_rng(3)
    M = rng.normal(size=(2, 7, 3, 3)) * 0.4
    slip = Slip(*(0.5 * (M + M.mT)), *rng.normal(size=(2, 7, 3)))
    x, y, f, g = rng.normal(size=(4, 7, 3))
    twist_a, twist_b = rng.normal(size=(2, 7, 6))
    dx, dy = push_forward(slip, x, y, twist_a, twist_b, coupling)
    wrench_a, wrench_b = pull_back(slip, x, y, f, g, coupling)
    left = (dx * f + dy * g).sum(axis=1)
    np.testing.assert_allclose(left, (wrench_a * twist_a + wrench_b * twist_b).sum(axis=1), rtol=1e-12, atol=1e-12)


def test_only_the_coupled_slip_follows_a_common_motion() -> None:
    rng = np.random.default_rng(5)
    M = rng.normal(size=(2, 3, 3)) * 0.3
    A, B = M[0] @ M[0].T, M[1] @ M[1].T
    x, y = rng.normal(size=(2, 3))
    twist = rng.normal(size=6)
    rigid = np.stack([twist[:3] + np.cross(twist[3:], p) for p in (x, y)])
    coupled = np.stack(push_forward(Slip(A, B, x, y), x, y, twist, twist, "coupled"))
    unilateral = np.stack(push_forward(Slip(A, B, x, y), x, y, twist, twist, "one-sided"))
    np.testing.assert_allclose(coupled, rigid, atol=1e-9)
    assert np.abs(unilateral - rigid).max() > 1e-3


# (b) distance smoothing against its own smoothed point


@pytest.mark.parametrize("gap", [0.004, -0.004])
@pytest.mark.parametrize(
    "rule", [Adaptive(), Adaptive(samples=None), Fixed(0.2), Neighbor()], ids=["16", "all", "fixed", "neighbor"]
)
def test_distance_smoothing_differentiates_its_own_smoothed_point(
    rule: Adaptive | Fixed | Neighbor, gap: float
) -> None:
    pairs = Pairs((rounded(0),), (rounded(1),))
    T_a, T_b = poses_at_gap(pairs, 4, gap, seed=9)
    w = query(pairs, T_a, T_b)
    layer = WitnessLayer(pairs, Distance(rule, smoothed_self=True))
    scene = WitnessScene(*layer.columns(np.array([0])), T_a, T_b, w, None, None, 0)
    sides, near = scene.neighbors(rule, 0)
    tau = temperature(near, sides.other)

    # The slip matrix: the smoothed point of the body at rest, as the other point moves.
    _, slip = smooth(near, sides.other, tau)
    for k in range(3):
        h = 1e-6 * np.eye(3)[k]
        slope = (smooth(near, sides.other + h, tau)[0] - smooth(near, sides.other - h, tau)[0]) / 2e-6
        np.testing.assert_allclose(slip[..., k], slope, atol=1e-6)

    # The self term: body a moves, the other witness y stays. dx* = V(x*) - A V(y).
    def smoothed_world(T: np.ndarray) -> np.ndarray:
        y = transform_points(inverse(T), w.point_b).swapaxes(0, 1)
        y = np.concatenate([y, sides.other[1:]])
        return transform_points(T, smooth(near, y, tau)[0][:1].swapaxes(0, 1))

    A = sides.rotation[:1] @ slip[:1] @ sides.rotation[:1].mT
    x_star = smoothed_world(T_a)
    for k in range(6):
        twist = np.eye(6)[k]
        slope = (smoothed_world(exp_se3(1e-6 * twist) @ T_a) - smoothed_world(exp_se3(-1e-6 * twist) @ T_a)) / 2e-6
        v, u = (twist[:3] + np.cross(twist[3:], p) for p in (x_star, w.point_b))
        np.testing.assert_allclose(v - matvec(A.swapaxes(0, 1), u), slope, atol=1e-6)


@pytest.mark.parametrize("method", [Distance(), ContactKinematics()], ids=["distance", "contact-kinematics"])
def test_bias_on_spheres_is_reported(
    method: Distance | ContactKinematics, record_property: pytest.FixtureRequest
) -> None:
    pairs = Pairs((build_body("a", [sphere(0.03)]),), (build_body("b", [sphere(0.02)]),))
    for gap in (0.02, 0.002, -0.004):
        T_a, T_b = poses_at_gap(pairs, 8, gap, seed=4)
        cotangents = random_cotangents(query(pairs, T_a, T_b), POINTS, seed=5)
        exact = layer_gradient(WitnessLayer(pairs, ExactSpheres(0.03, 0.02)), T_a, T_b, cotangents)
        found = layer_gradient(WitnessLayer(pairs, method), T_a, T_b, cotangents)
        bias = float(np.linalg.norm(found - exact) / np.linalg.norm(exact))
        cosine = float((found * exact).sum() / np.linalg.norm(found) / np.linalg.norm(exact))
        record_property(f"relative bias at a gap of {gap} m", bias)
        print(f"{type(method).__name__}: relative bias {bias:.3f}, cosine {cosine:.3f} at a gap of {1e3 * gap:g} mm")
        # Sampled slips are too large near contact; they still point the right way.
        assert bias < (0.05 if isinstance(method, ContactKinematics) else 1.0) and cosine > 0.7


@dataclass(frozen=True)
class ExactCurvature(ContactKinematics):
    """Contact kinematics with the true curvature of two spheres."""

    radii: tuple[float, float] = (0.03, 0.02)

    def curvatures(self, scene: WitnessScene, E: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        eye = np.broadcast_to(np.eye(2), (*E.shape[:2], 2, 2))
        return eye / self.radii[0], eye / self.radii[1]


@pytest.mark.parametrize("gap", [0.02, 1e-4, 0.0, -1e-4, -0.008])
def test_contact_kinematics_is_exact_with_the_true_curvature(gap: float) -> None:
    pairs = Pairs((build_body("a", [sphere(0.03, (0.01, 0, 0))]),), (build_body("b", [sphere(0.02)]),))
    T_a, T_b = poses_at_gap(pairs, 5, gap, seed=6)
    cotangents = random_cotangents(query(pairs, T_a, T_b), ALL, seed=7)
    expected = slopes_along_twists(lambda a, b: contracted(query(pairs, a, b), cotangents), T_a, T_b, 1e-5)
    found = layer_gradient(WitnessLayer(pairs, ExactCurvature()), T_a, T_b, cotangents)
    np.testing.assert_allclose(found, expected, atol=2e-5, rtol=1e-5)


# (c) the exact signed-distance gradient


@pytest.mark.parametrize("gap", [0.01, 1e-4, -0.003])
@pytest.mark.parametrize("bodies", BODIES)
def test_signed_distance_gradient_is_exact(bodies: str, gap: float) -> None:
    a, b = BODIES[bodies]()
    pairs = Pairs((a,), (b,))
    T_a, T_b = poses_at_gap(pairs, 12, gap, seed=11)
    step = 1e-6

    def distance(T_a: np.ndarray, T_b: np.ndarray) -> np.ndarray:
        return query(pairs, T_a, T_b).distance[:, 0]

    expected = slopes_along_twists(distance, T_a, T_b, step)
    found = layer_gradient(WitnessLayer(pairs, Distance()), T_a, T_b, {"distance": np.ones((12, 1))})
    # The witness pair is unique where one-sided differences agree with the central one.
    forward = slopes_along_twists(distance, T_a, T_b, 5 * step)
    unique = np.abs(forward - expected).max(axis=0) < 1e-7
    assert unique.sum() >= 6
    np.testing.assert_allclose(found[:, unique], expected[:, unique], atol=1e-6)


# the layer as a torch function


def test_two_forwards_before_one_backward_and_any_batch_size() -> None:
    pairs = Pairs((rounded(0), rounded(2)), (rounded(1), rounded(1)))
    layer = WitnessLayer(pairs, ContactKinematics())
    results = []
    for count in (1, 7, 3):
        T_a, T_b = (np.repeat(random_poses(count, seed), 2, axis=1) for seed in (40, 41))
        T_b[..., 0, 3] += 0.09
        tensors = [torch.from_numpy(T).requires_grad_() for T in (T_a, T_b)]
        results.append((tensors, layer(*tensors)))
    for _, w in results:
        (w.point_a * w.normal).sum().backward()
    for tensors, _ in results:
        alone = [t.detach().clone().requires_grad_() for t in tensors]
        w = layer(*alone)
        (w.point_a * w.normal).sum().backward()
        for t, s in zip(tensors, alone, strict=True):
            assert torch.equal(t.grad, s.grad)


def test_the_derivative_is_taken_only_where_the_loss_looks() -> None:
    class Raises:
        def pull_back(self, *_: object) -> tuple[np.ndarray, np.ndarray]:
            raise AssertionError("asked without need")

    pairs = Pairs((rounded(0),), (rounded(1),))
    T_a, T_b = poses_at_gap(pairs, 3, 0.01, seed=50)
    layer_gradient(WitnessLayer(pairs, Raises()), T_a, T_b, {"distance": np.ones((3, 1))})


def test_pairs_without_witness_points_get_no_gradient() -> None:
    pairs = Pairs((rounded(0),), (rounded(1),))
    T_a, T_b = poses_at_gap(pairs, 3, 0.01, seed=51)
    T_b[1, 0, 0, 3] = np.nan
    tensors = [torch.from_numpy(T).requires_grad_() for T in (T_a, T_b)]
    w = WitnessLayer(pairs, Distance())(*tensors)
    (w.point_a.sum() + w.normal.sum()).backward()
    assert not tensors[0].grad[1].any()
    assert torch.isfinite(tensors[0].grad).all() and tensors[0].grad[0].any()


def test_single_precision_poses_give_single_precision_results() -> None:
    pairs = Pairs((rounded(0),), (rounded(1),))
    T_a, T_b = (torch.from_numpy(T).float().requires_grad_() for T in poses_at_gap(pairs, 3, 0.01, seed=52))
    w = WitnessLayer(pairs, Distance())(T_a, T_b)
    w.distance.sum().backward()
    assert w.point_a.dtype == T_a.grad.dtype == torch.float32


def test_wrong_shapes_are_refused() -> None:
    pairs = Pairs((rounded(0),), (rounded(1),))
    with refused(CollisionError, "(batch, 1, 4, 4)"):
        WitnessLayer(pairs, Distance())(torch.eye(4)[None], torch.eye(4)[None])


def test_bodies_with_different_numbers_of_candidates_are_refused() -> None:
    few = build_body("few", [sphere(0.01)], candidates=64)
    with refused(CollisionError, "64, 1024"):
        WitnessLayer(Pairs((few,), (rounded(0),)), Distance()).columns(np.array([0]))


def test_cross_matches_numpy() -> None:
    a, b = np.random.default_rng(0).normal(size=(2, 5, 3))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b))
