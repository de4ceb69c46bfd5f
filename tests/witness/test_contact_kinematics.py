"""Contact kinematics: exact with true curvatures at every signed distance; what the fit makes of samples."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from ellipsoids import Contact, Ellipsoid, at_gap, motion
from grasp_refine.collision.query import Pairs, QueryStatus, Witness, query
from grasp_refine.core.se3 import exp_se3, tangents, transform_points
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box, sphere
from grasp_refine.witness.autograd import WitnessLayer
from grasp_refine.witness.contact_kinematics import (
    ContactKinematics,
    _fit,
    contact_slip_jacobian,
    effective_distance,
    relative_curvature,
)
from grasp_refine.witness.neighborhood import Adaptive, Neighbors
from grasp_refine.witness.scene import WitnessScene
from shapes_for_tests import convex_body
from twists import poses_at_gap

pytestmark = pytest.mark.usefixtures("engine")

SAMPLED, SIXTEEN = (ContactKinematics(Adaptive(samples=count), sampled=True) for count in (None, 16))


@dataclass(frozen=True)
class ExactEllipsoids(ContactKinematics):
    """Contact kinematics with the curvatures of the ellipsoids (one pair of them per item) instead of fitted ones."""

    bodies: tuple[tuple[Ellipsoid, Ellipsoid], ...] = ()

    def curvatures(self, scene: WitnessScene, E: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        n = scene.witness.normal[:, 0]
        K = [(a.curvature(n[i], E[i, 0]), b.curvature(-n[i], E[i, 0])) for i, (a, b) in enumerate(self.bodies)]
        return np.array([k[0] for k in K])[:, None], np.array([k[1] for k in K])[:, None]


def scene_of(contacts: list[Contact]) -> WitnessScene:
    """One pair of bodies, whose poses and candidates nobody looks at, with the given witness points."""
    pairs = Pairs((convex_body(0),), (convex_body(1),))
    fields = [np.array([getattr(c, name) for c in contacts])[:, None] for name in ("x_a", "x_b", "n", "d")]
    count = len(contacts)
    status = np.where(fields[3] > 0, QueryStatus.SEPARATED, QueryStatus.PENETRATING)
    zero = np.zeros((count, 1), dtype=int)
    T = np.tile(np.eye(4), (count, 1, 1, 1))
    surfaces = WitnessLayer(pairs, ContactKinematics()).columns(np.array([0]))[1]
    return WitnessScene(pairs, surfaces, T, T, Witness(*fields, status, zero, zero), None, None, 0)


@pytest.mark.parametrize("gap", [0.05, 0.003, 1e-9, 0.0, -1e-9, -1e-3, -0.006])
def test_true_curvatures_of_ellipsoids_give_the_true_motion(gap: float) -> None:
    found = [at_gap(seed, gap) for seed in range(4)]
    scene = scene_of([c for _, _, c in found])
    method = ExactEllipsoids(bodies=tuple((a, b) for a, b, _ in found))
    forces = np.random.default_rng(0).normal(size=(3, 4, 1, 3))
    wrenches = np.concatenate([w[:, 0] for w in method.pull_back(scene, *forces)], axis=1)
    for i, (a, b, c) in enumerate(found):
        expected = np.einsum("kij,ij->k", motion(a, b, c.n), forces[:, i, 0])
        np.testing.assert_allclose(wrenches[i], expected, rtol=1e-6, atol=1e-6)


# in penetration, deeper than surfaces are round


def balls_apart(
    gap: float, twist: np.ndarray, radius_a: float = 0.03, radius_b: float = 0.02
) -> tuple[np.ndarray, ...]:
    """Witness points, normal and signed distance of two balls of which the second moved by a twist."""
    n = np.array([0.48, 0.6, 0.64])
    a = np.array([0.01, -0.02, 0.03])
    b = transform_points(exp_se3(twist), a + (radius_a + radius_b + gap) * n)
    away = np.linalg.norm(b - a)
    n = (b - a) / away
    return a + radius_a * n, b - radius_b * n, n, np.asarray(away - radius_a - radius_b)


@pytest.mark.parametrize("gap", [0.002, -1e-6, -1e-3, -5e-3, -0.0149])
def test_the_slide_on_balls_in_penetration_is_exact_up_to_half_a_radius(gap: float) -> None:
    _, x_b, n, d = balls_apart(gap, np.zeros(6))
    E = tangents(n)
    U_a, U_b = contact_slip_jacobian(x_b, n, d, E, np.eye(2) / 0.03, np.eye(2) / 0.02)
    for k in range(6):
        twist = 1e-6 * np.eye(6)[k]
        ends = [balls_apart(gap, sign * twist) for sign in (1.0, -1.0)]
        # Ball a rests; on ball b a point is seen from the moved ball.
        on_a = (ends[0][0] - ends[1][0]) / 2e-6
        on_b = transform_points(exp_se3(-twist), ends[0][1]) - transform_points(exp_se3(twist), ends[1][1])
        np.testing.assert_allclose(E @ U_a[:, k], on_a, atol=1e-7)
        np.testing.assert_allclose(E @ U_b[:, k], on_b / 2e-6, atol=1e-7)


def random_curvatures(count: int, seed: int) -> np.ndarray:
    """Curvatures (2, count, 2, 2) of convex bodies: flat, round, edges and corners, in any direction."""
    rng = np.random.default_rng(seed)
    values = rng.choice([1.0, 30.0, 80.0, 300.0, 2e3, 1e4], (2, count, 2))
    turn = rng.uniform(0, np.pi, (2, count))
    c, s = np.cos(turn), np.sin(turn)
    R = np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
    return R @ (values[..., None] * R.mT)


DEPTHS = [0.0, -1e-6, -1e-4, -1e-3, -2e-3, -5e-3]


@pytest.mark.parametrize("depth", DEPTHS)
def test_relative_curvature_never_turns_its_sign_in_penetration(depth: float) -> None:
    """S = M (M^-1 K_b + K_a) with M = I + d K_b at least a half: two positive factors."""
    K_a, K_b = random_curvatures(500, 5)
    S = relative_curvature(K_a, K_b, np.full(500, depth))
    values = np.linalg.eigvals(S)
    assert (values.real > 0).all() and (np.abs(values.imag) < 1e-6 * values.real).all()
    ratio = np.linalg.det(S) / np.linalg.det(K_a + K_b)
    assert (ratio >= 0.25 - 1e-9).all()
    if depth < -1e-3:
        naive = np.linalg.det(K_a + K_b + depth * (K_b @ K_a))
        assert (naive < 0).sum() > 20, "without the bound, many would have turned"
    # Where d times the smaller of the two curvatures is below a half, nothing is bounded.
    mild = -depth * np.minimum(*(np.linalg.eigvalsh(K).max(axis=-1) for K in (K_a, K_b))) < 0.5
    np.testing.assert_allclose(S[mild], (K_a + K_b + depth * (K_b @ K_a))[mild], rtol=1e-12)
    assert mild.sum() > 50 and (depth > -1e-3 or not mild.all())


@pytest.mark.parametrize("depth", DEPTHS)
def test_the_slide_is_the_same_seen_from_the_other_body(depth: float) -> None:
    """At corners in corners, deep inside each other, points on one body once slid by thirty times the movement."""
    K_a, K_b = random_curvatures(200, 6)
    rng = np.random.default_rng(7)
    n, x_b = rng.normal(size=(2, 200, 3))
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    E, d = tangents(n), np.full(200, depth)
    U_a, U_b = contact_slip_jacobian(x_b, n, d, E, K_a, K_b)
    # The tangents of -n, right-handed; the twist of a relative to b. Bounded, d is that between the points no more.
    turned, flip = E[..., ::-1], (slice(None), slice(None, None, -1), slice(None, None, -1))
    share = effective_distance(K_a, K_b, d)[:, None]
    swapped_a, swapped_b = contact_slip_jacobian(x_b - share * n, -n, d, turned, K_b[flip], K_a[flip])
    np.testing.assert_allclose(turned @ swapped_a, -E @ U_b, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(turned @ swapped_b, -E @ U_a, rtol=1e-9, atol=1e-9)


# the fit


def balls(radius_a: float, radius_b: float, candidates: int) -> Pairs:
    pieces = sphere(radius_a, (0.01, 0, 0)), sphere(radius_b)
    return Pairs(*((build_body("ball", [piece], candidates=candidates),) for piece in pieces))


def curvatures(pairs: Pairs, method: ContactKinematics, gap: float) -> tuple[np.ndarray, np.ndarray]:
    T_a, T_b = poses_at_gap(pairs, 8, gap, seed=1)
    witness = query(pairs, T_a, T_b)
    columns = WitnessLayer(pairs, method).columns(np.array([0]))
    scene = WitnessScene(*columns, T_a, T_b, witness, None, None, 0)
    return method.curvatures(scene, tangents(witness.normal))


@pytest.mark.parametrize("gap", [0.01, 0.0, -0.005])
@pytest.mark.parametrize("method", [ContactKinematics(), SAMPLED, SIXTEEN], ids=["around", "all", "16"])
def test_fitted_curvature_of_finely_sampled_balls(
    method: ContactKinematics, gap: float, record_property: Callable[[str, object], None]
) -> None:
    K_a, K_b = curvatures(balls(0.03, 0.02, 8192), method, gap)
    for name, K, radius in (("a", K_a, 0.03), ("b", K_b, 0.02)):
        values = np.linalg.eigvalsh(K) * radius
        bias = values.mean() - 1
        record_property(f"relative bias of the curvature of {name}", float(bias))
        np.testing.assert_allclose(values, 1.0, atol=0.3)


def quadric(K: np.ndarray, count: int, seed: int, radius: float = 0.01) -> tuple[Neighbors, np.ndarray]:
    """Samples whose normals obey E^T n = b + K E^T (v - x) exactly, and their tangent basis E."""
    rng = np.random.default_rng(seed)
    E = tangents(np.array([[[0.0, 0.6, 0.8]]]))
    x = rng.normal(size=3)
    e = rng.uniform(-0.7, 0.7, (count, 2)) * radius
    points = np.concatenate([np.zeros((1, 3)), e @ E[0, 0].T]) + x
    normals = (e @ K.T + [0.02, -0.01]) @ E[0, 0].T
    mask = np.ones((1, 1, count + 1), dtype=bool)
    return Neighbors(points[None, None], normals[None, None], mask, np.full((1, 1), radius), np.zeros((1, 1))), E


@pytest.mark.parametrize("values", [(30.0, 5.0), (10.0, -20.0), (0.0, 0.0)])
def test_the_fit_recovers_a_quadric(values: tuple[float, float]) -> None:
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    K = turn @ np.diag(values) @ turn.T
    near, E = quadric(K, 40, seed=2)
    # The ridge takes about rho^2 / 1000 over the mean square of the offsets.
    np.testing.assert_allclose(_fit(near, E)[0, 0], K, atol=0.02 * np.abs(values).max() + 1e-12)
    # Samples that are masked do not count.
    spoiled = near.normals.copy()
    spoiled[0, 0, 30:] = 99.0
    mask = near.mask.copy()
    mask[0, 0, 31:] = False
    found = _fit(replace(near, normals=spoiled, mask=mask), E)[0, 0]
    np.testing.assert_allclose(found, K, atol=0.02 * np.abs(values).max() + 1e-12)


def test_the_fit_is_clipped_to_what_samples_of_that_spread_can_tell() -> None:
    near, E = quadric(np.diag([1e5, -1e5]), 40, seed=3)
    np.testing.assert_allclose(np.linalg.eigvalsh(_fit(near, E)[0, 0]), [-1 / 0.01, 4 / 0.01], rtol=1e-12)


def test_flat_faces_get_the_smallest_curvature() -> None:
    pairs = Pairs(*((build_body("box", [box([0.08, 0.08, 0.04])]),) for _ in range(2)))
    T, T_b = np.eye(4)[None, None], np.eye(4)[None, None].copy()
    T_b[..., :3, 3] = [0.001, 0.002, 0.05]
    witness = query(pairs, T, T_b)
    middle = replace(witness, point_a=np.array([[[0, 0, 0.02]]]), point_b=np.array([[[0, 0, 0.03]]]))
    method = ContactKinematics(Adaptive(samples=None, without_target=1.5))
    scene = WitnessScene(*WitnessLayer(pairs, method).columns(np.array([0])), T, T_b, middle, None, None, 0)
    K_a, K_b = method.curvatures(scene, tangents(witness.normal))
    np.testing.assert_allclose(K_a + K_b, 5.0 / pairs.a[0].extent * np.eye(2)[None, None], atol=1e-9)
    np.testing.assert_allclose(K_a, K_b, atol=1e-9)
