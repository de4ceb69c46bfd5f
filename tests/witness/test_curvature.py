"""Curvatures fitted to candidates: surfaces of known curvature, eigenvalues, and rows that ignore each other."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest

from grasp_refine.collision.engine import chosen, why_not_native
from grasp_refine.core.se3 import tangents
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import box, capsule, hull, sphere
from grasp_refine.geometry.sampling import Candidates
from grasp_refine.witness.curvature import Curvatures, raise_eigenvalues, smallest_radii, with_eigenvalues

if TYPE_CHECKING:
    from grasp_refine.witness.native_kinematics import NativeCurvatures

pytestmark = pytest.mark.usefixtures("engine")
native = pytest.mark.skipif(bool(why_not_native()), reason=f"no compiled engine: {why_not_native()}")

FINE = 8192
"""Candidates of finely sampled bodies."""


@cache
def ball(radius: float, center: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Body:
    return build_body("ball", [sphere(radius, center)], candidates=FINE)


def curvatures_of(bodies: Sequence[Body]) -> "Curvatures | NativeCurvatures":
    """Fit of the engine in use."""
    if chosen("auto") == "python":
        return Curvatures.of(bodies)
    from grasp_refine.witness.native_kinematics import NativeCurvatures

    return NativeCurvatures.of(bodies)


def random_directions(count: int, seed: int) -> np.ndarray:
    n = np.random.default_rng(seed).normal(size=(count, 3))
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def fit(body: Body, x: np.ndarray, n: np.ndarray, radius: float, E: np.ndarray | None = None) -> np.ndarray:
    """Curvatures (R, 2, 2) of one body at x (R, 3)."""
    E = tangents(n) if E is None else E
    return curvatures_of([body]).fit(np.zeros(len(x), dtype=int), x, n, E, np.full(len(x), radius))


# surfaces of known curvature


@pytest.mark.parametrize("radius", [0.01, 0.03, 0.2])
def test_balls_have_one_over_their_radius_all_round(
    radius: float, record_property: Callable[[str, object], None]
) -> None:
    """Off by the ridge (rho^2 / 1000 over the spread rho^2 / 6 of the offsets), by the bend, and by sampling noise."""
    center = np.array([0.1, -0.2, 0.3])
    n = random_directions(50, 1)
    K = fit(ball(radius, tuple(center)), center + radius * n, n, 0.3 * radius)
    values = radius * np.linalg.eigvalsh(K)
    record_property("relative bias", float(values.mean() - 1.0))
    assert abs(values.mean() - 1.0) < 0.03 and values.std() < 0.05
    np.testing.assert_array_equal(K[:, 0, 1], K[:, 1, 0])


def test_a_cylinder_bends_across_its_axis_only() -> None:
    rod = build_body("rod", [capsule(0.02, (0, 0, -0.1), (0, 0, 0.1))], candidates=FINE)
    angle = np.linspace(0, 6, 20)
    n = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    E = tangents(n)
    K = fit(rod, 0.02 * n, n, 0.008)
    in_space = E @ K @ E.mT
    around = np.cross([0.0, 0.0, 1.0], n)
    expected = around[:, :, None] * around[:, None, :] / 0.02
    np.testing.assert_allclose(in_space, expected, atol=0.1 / 0.02)


def test_a_plane_is_flat_and_its_edge_is_as_sharp_as_the_neighbourhood_can_tell() -> None:
    body = build_body("box", [box([0.2, 0.2, 0.2])], candidates=FINE)
    up = np.array([[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(fit(body, np.array([[0.01, 0.02, 0.1]]), up, 0.02), 0.0, atol=1e-3)
    E = np.eye(3)[None, :, :2]
    n = np.array([[np.sqrt(0.5), 0.0, np.sqrt(0.5)]])
    E = np.stack([np.array([[-np.sqrt(0.5), 0.0, np.sqrt(0.5)]]), np.array([[0.0, 1.0, 0.0]])], axis=-1)
    K = fit(body, np.array([[0.1, 0.0, 0.1]]), n, 0.01, E)
    assert 0.5 / 0.01 < K[0, 0, 0] <= 4.0 / 0.01 and abs(K[0, 1, 1]) < 0.05 / 0.01


def test_the_inside_of_a_ring_is_concave() -> None:
    """Forty wedges: around its axis -1/R, along it flat."""
    edges = np.linspace(0.0, 2.0 * np.pi, 41)
    corners = [
        [(r * np.cos(a), r * np.sin(a), z) for r in (0.05, 0.07) for a in pair for z in (-0.04, 0.04)]
        for pair in zip(edges[:-1], edges[1:], strict=True)
    ]
    ring = build_body("ring", [hull(c) for c in corners], candidates=FINE)
    n = -np.array([[np.cos(a), np.sin(a), 0.0] for a in np.linspace(0, 6, 15)])
    E = tangents(n)
    in_space = E @ fit(ring, -0.05 * n, n, 0.02) @ E.mT
    around = np.cross([0.0, 0.0, 1.0], n)
    bent = np.einsum("ri,rij,rj->r", around, in_space, around)
    np.testing.assert_allclose(bent, -1 / 0.05, atol=0.2 / 0.05)
    np.testing.assert_allclose(in_space[:, 2, 2], 0.0, atol=0.1 / 0.05)


def test_the_other_side_of_a_thin_lens_does_not_count() -> None:
    """Its normals are more than 120 degrees away; else the flat side would look as bent as the other one."""
    angle, radius = (part.ravel() for part in np.meshgrid(np.linspace(0, 6.2, 60), np.linspace(0, 0.1, 25)))
    back = np.stack([radius * np.cos(angle), radius * np.sin(angle), -0.002 - 0.02 * (1 - (radius / 0.1) ** 2)], axis=1)
    lens = build_body("lens", [hull(np.concatenate([back, back * [1, 1, 0]]))], candidates=FINE)
    up = np.array([[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(fit(lens, np.array([[0.01, 0.0, 0.0]]), up, 0.05), 0.0, atol=1e-2)


def test_the_smallest_radius_holds_sixteen_of_1024_candidates_on_a_plane() -> None:
    body = build_body("box", [box([0.3, 0.3, 0.3])], candidates=1024)
    x = np.random.default_rng(3).uniform(-0.1, 0.1, (50, 2))
    on_top = body.candidates.points[body.candidates.normals[:, 2] > 0.5][:, :2]
    inside = (np.linalg.norm(on_top - x[:, None], axis=2) < smallest_radii([body])[0]).sum(axis=1)
    assert inside.mean() == pytest.approx(16, abs=2)


# rows


def many_rows(count: int) -> tuple[list[Body], tuple[np.ndarray, ...]]:
    """Items on two bodies in random order, with radii that hold few candidates, so that rounding shows."""
    bodies = [
        build_body("rod", [capsule(0.02, (0, 0, -0.05), (0, 0, 0.05))], candidates=256),
        build_body("box", [box([0.05, 0.06, 0.07])], candidates=256),
    ]
    rng = np.random.default_rng(4)
    body, pick = rng.integers(2, size=count), rng.integers(256, size=count)
    x = np.stack([bodies[b].candidates.points[p] for b, p in zip(body, pick, strict=True)])
    n = np.stack([bodies[b].candidates.normals[p] for b, p in zip(body, pick, strict=True)])
    return bodies, (body, x, n, tangents(n), rng.uniform(0.005, 0.06, count))


@pytest.mark.parametrize("count", [1, 2, 7, 64, 129])
def test_a_row_does_not_depend_on_the_others_to_the_last_bit(count: int) -> None:
    """One matrix product for all rows once made K differ by 5e-4 with their number: refined grasps then did, too."""
    bodies, rows = many_rows(300)
    curvatures = curvatures_of(bodies)
    every = curvatures.fit(*rows)
    rng = np.random.default_rng(count)
    for _ in range(5):
        some = rng.permutation(300)[:count]
        np.testing.assert_array_equal(curvatures.fit(*(a[some] for a in rows)), every[some])


def test_single_precision_about_the_centre_suffices() -> None:
    """Against the same least squares in double precision, on a body a metre off its origin."""
    body, radius = build_body("rod", [capsule(0.02, (1, 0, -0.05), (1, 0, 0.05))], candidates=1024), 0.012
    c = body.candidates
    x, n = c.points[:30], c.normals[:30]
    E = tangents(n)
    expected = []
    for at, facing, basis in zip(x, n, E, strict=True):
        offset = c.points - at
        weight = np.maximum(1.0 - (offset**2).sum(axis=1) / radius**2, 0.0) * (c.normals @ facing >= -0.5)
        weight /= weight.sum()
        e, m = offset @ basis, c.normals @ basis
        e, m = e - weight @ e, m - weight @ m
        K = np.linalg.solve((weight * e.T) @ e + 1e-3 * radius**2 * np.eye(2), (weight * e.T) @ m)
        values, vectors = np.linalg.eigh(0.5 * (K + K.T))
        expected.append(vectors @ np.diag(np.clip(values, -1 / radius, 4 / radius)) @ vectors.T)
    np.testing.assert_allclose(fit(body, x, n, radius), expected, atol=1e-3 / radius)


@pytest.mark.parametrize(("expected", "first"), [(20, 8192), (60, 8192), (70, 4096), (500, 1024), (1e6, 32)])
def test_a_wide_neighbourhood_is_fitted_to_a_sample_of_it(expected: float, first: int) -> None:
    """Of as many candidates as a disc of the radius holds, all count, or those left after halvings, at least 32."""
    body = build_body("hull", [hull(np.random.default_rng(2).normal(size=(40, 3)) * 0.02)], candidates=FINE)
    c = body.candidates
    radius = np.sqrt(expected * body.area / (FINE * np.pi))
    found = fit(body, c.points[-40:], c.normals[-40:], radius)

    def of_the_first(count: int) -> np.ndarray:
        some = Candidates(c.points[:count], c.normals[:count], FINE / first * c.areas[:count])
        return fit(Body("part", body.pieces, some), c.points[-40:], c.normals[-40:], radius)

    np.testing.assert_allclose(found, of_the_first(first), atol=1e-3 / radius)
    assert np.abs(found - of_the_first(first // 2)).max() > 0.01 / radius


@native
def test_both_engines_fit_the_same_at_any_width_and_number_of_candidates() -> None:
    from grasp_refine.witness.native_kinematics import NativeCurvatures

    for candidates in (1, 16, 17, 100, 1024):
        body = build_body("hull", [hull(np.random.default_rng(2).normal(size=(40, 3)) * 0.02)], candidates=candidates)
        c, rng = body.candidates, np.random.default_rng(3)
        pick = rng.integers(candidates, size=200)
        n, radius = random_directions(200, 4), 10 ** rng.uniform(-2.5, 0.5, 200)
        x = c.points[pick] + 1e-3 * n
        rows = np.zeros(200, dtype=int), x, n, tangents(n), radius
        found, expected = NativeCurvatures.of([body]).fit(*rows), Curvatures.of([body]).fit(*rows)
        # A candidate at the rim of its neighbourhood counts a little, or not at all, by rounding.
        np.testing.assert_allclose(radius[:, None, None] * found, radius[:, None, None] * expected, atol=2e-2)
        assert np.median(np.abs(radius[:, None, None] * (found - expected))) < 1e-5


# eigenvalues


def symmetric(count: int, seed: int) -> np.ndarray:
    M = np.random.default_rng(seed).normal(size=(count, 2, 2)) * 10.0 ** np.arange(-3, count - 3)[:, None, None]
    M = M + M.mT
    M[0], M[1] = 0.0, 3.0 * np.eye(2)
    M[2] = np.diag([2.0, -1.0])
    return M


@pytest.mark.parametrize("function", [np.abs, lambda v: np.clip(v, -1.0, 4.0), lambda v: 2.0 + 0.0 * v])
def test_functions_of_eigenvalues_are_as_in_eigh(function: Callable[[np.ndarray], np.ndarray]) -> None:
    K = symmetric(9, 5)
    values, vectors = np.linalg.eigh(K)
    expected = vectors @ (function(values)[..., None] * vectors.mT)
    scale = 1.0 + np.abs(K).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(with_eigenvalues(K, function) / scale, expected / scale, atol=1e-14)


def test_the_sum_is_raised_to_its_floor_and_the_difference_stays() -> None:
    rng = np.random.default_rng(6)
    K_a, K_b = (M + M.mT for M in rng.normal(size=(2, 30, 2, 2)) * 20)
    floor = rng.uniform(0, 40, 30)
    new_a, new_b = raise_eigenvalues(K_a, K_b, floor)
    np.testing.assert_allclose(new_a - new_b, K_a - K_b, atol=1e-12)
    before, vectors = np.linalg.eigh(K_a + K_b)
    expected = vectors @ (np.maximum(before, floor[:, None])[..., None] * vectors.mT)
    np.testing.assert_allclose(new_a + new_b, expected, atol=1e-12)
    high = (before >= floor[:, None]).all(axis=1)
    assert high.any() and not high.all()
    np.testing.assert_allclose(new_a[high], K_a[high], atol=1e-12)
