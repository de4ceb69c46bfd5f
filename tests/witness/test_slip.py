"""The slip algebra: exact slips give exact motions, and what sampled slips are made into."""

import numpy as np
import pytest

from ellipsoids import Contact, Ellipsoid, at_gap, motion
from grasp_refine.collision.query import Pairs, QueryStatus, Witness
from grasp_refine.witness.neighborhood import Surfaces
from grasp_refine.witness.scene import WitnessScene
from grasp_refine.witness.slip import Slip, contract, pull_back_witness
from shapes_for_tests import convex_body
from twists import slip_velocities

GAPS = (0.05, 0.003, -1e-3, -0.006)


def exact_slip(a: Ellipsoid, b: Ellipsoid, c: Contact) -> Slip:
    """A = (I + d K)^-1 P of either body, from its closed-form curvature."""
    matrices = []
    for body, n in ((a, c.n), (b, -c.n)):
        K = body.curvature(n, c.E)
        matrices.append(c.E @ np.linalg.inv(np.eye(2) + c.d * K) @ c.E.T)
    return Slip(*matrices, c.x_a, c.x_b, sampled=False)


def scene_at(c: Contact, spacing: float) -> WitnessScene:
    """A scene with that one witness pair, and candidates of a given spacing that nobody looks at."""
    bodies = (convex_body(0), convex_body(1))
    surfaces = Surfaces.of(bodies)
    surfaces = Surfaces(surfaces.points, surfaces.normals, np.full(2, spacing), surfaces.diagonal)
    witness = Witness(
        *(v[None, None] for v in (c.x_a, c.x_b, c.n)), np.array([[c.d]]), np.array([[QueryStatus.SEPARATED]]),
        np.zeros((1, 1), dtype=int), np.ones((1, 1), dtype=int),
    )  # fmt: skip
    here = np.eye(4)[None, None]
    return WitnessScene(Pairs(bodies[:1], bodies[1:]), surfaces, here, here, witness, None, None, 0)


def unit_twists() -> tuple[np.ndarray, np.ndarray]:
    """The six twists of body a alone, then of body b alone, (12, 6) each."""
    both = np.eye(12)
    return both[:, :6], both[:, 6:]


@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("seed", range(3))
def test_exact_slips_of_ellipsoids_move_their_witness_points(seed: int, gap: float) -> None:
    a, b, c = at_gap(seed, gap)
    dx_a, dx_b = slip_velocities(exact_slip(a, b, c), c.x_a, c.x_b, *unit_twists())
    expected = motion(a, b, c.n)
    np.testing.assert_allclose(dx_a, expected[:, 0], atol=1e-6)
    np.testing.assert_allclose(dx_b, expected[:, 1], atol=1e-6)


@pytest.mark.parametrize("gap", GAPS)
def test_exact_slips_of_ellipsoids_turn_the_normal(gap: float) -> None:
    a, b, c = at_gap(5, gap)
    expected = motion(a, b, c.n)
    rng = np.random.default_rng(6)
    forces = rng.normal(size=(3, 1, 1, 3))
    # Candidates without spacing: the normal is that of the points' difference at every distance.
    slip = exact_slip(a, b, c)
    slip = Slip(*(v[None, None] for v in (slip.A, slip.B, slip.self_a, slip.self_b)), sampled=False)
    wrenches = pull_back_witness(slip, scene_at(c, 0.0), *forces, "coupled")
    found = np.concatenate([w[0, 0] for w in wrenches])
    np.testing.assert_allclose(found, np.einsum("kij,ij->k", expected, forces[:, 0, 0]), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("spacing", [1e-5, 1e-3, 1.0])
@pytest.mark.parametrize("gap", [0.02, 1e-6, 0.0, -0.004])
def test_a_common_motion_turns_the_normal_with_it_at_every_gap(gap: float, spacing: float) -> None:
    a, b, c = at_gap(7, gap)
    slip = exact_slip(a, b, c)
    slip = Slip(0.9 * slip.A[None, None], 0.9 * slip.B[None, None], slip.self_a[None, None], slip.self_b[None, None])
    force = np.random.default_rng(8).normal(size=(1, 1, 3))
    zero = np.zeros_like(force)
    w_a, w_b = pull_back_witness(slip, scene_at(c, spacing), zero, zero, force, "coupled")
    np.testing.assert_allclose((w_a + w_b)[0, 0, :3], 0.0, atol=1e-9 * max(1, np.abs(w_a).max()))
    np.testing.assert_allclose((w_a + w_b)[0, 0, 3:], np.cross(c.n, force[0, 0]), atol=1e-9 * max(1, np.abs(w_a).max()))


def test_one_sided_slip_is_the_papers_equation() -> None:
    rng = np.random.default_rng(10)
    A, B = rng.normal(size=(2, 3, 3))
    x_a, x_b, s_a, s_b = rng.normal(size=(4, 3))
    twist_a, twist_b = rng.normal(size=(2, 6))

    def V(twist: np.ndarray, p: np.ndarray) -> np.ndarray:
        return twist[:3] + np.cross(twist[3:], p)

    # dx_a = V_a(x_a*) - A V_a(x_b) + A [V_b(x_b*) - B V_b(x_a)], and the same with a and b exchanged.
    expected_a = V(twist_a, s_a) - A @ V(twist_a, x_b) + A @ (V(twist_b, s_b) - B @ V(twist_b, x_a))
    expected_b = V(twist_b, s_b) - B @ V(twist_b, x_a) + B @ (V(twist_a, s_a) - A @ V(twist_a, x_b))
    found = slip_velocities(Slip(A, B, s_a, s_b), x_a, x_b, twist_a, twist_b, "one-sided")
    np.testing.assert_allclose(found, [expected_a, expected_b], atol=1e-13)


def test_the_coupled_solve_satisfies_both_slip_equations() -> None:
    rng = np.random.default_rng(11)
    M = rng.normal(size=(2, 3, 3))
    A, B = (m @ m.T / (1.1 * np.linalg.norm(m @ m.T, 2)) for m in M)
    x_a, x_b = rng.normal(size=(2, 3))
    twist_a, twist_b = rng.normal(size=(2, 6))
    dx_a, dx_b = slip_velocities(Slip(A, B, x_a, x_b), x_a, x_b, twist_a, twist_b)

    def V(twist: np.ndarray, p: np.ndarray) -> np.ndarray:
        return twist[:3] + np.cross(twist[3:], p)

    # Body a at rest: its point follows the other one's velocity relative to it, and the same for b.
    np.testing.assert_allclose(dx_a - V(twist_a, x_a), A @ (dx_b - V(twist_a, x_b)), atol=1e-12)
    np.testing.assert_allclose(dx_b - V(twist_b, x_b), B @ (dx_a - V(twist_b, x_a)), atol=1e-12)


@pytest.mark.parametrize("gap", [0.0, 1e-15, 1e-13, 1e-9])
def test_points_follow_a_common_motion_where_sliding_is_open(gap: float) -> None:
    """Closer than 1e-11 radii, they once stayed behind when both bodies moved."""
    across = np.diag([1.0, 1.0, 0.0])
    A, B = (r / (r + gap) * across for r in (0.03, 0.02))
    x_a = np.array([0.01, 0.02, 0.03])
    x_b = x_a + [0.0, 0.0, gap]
    slip = Slip(A, B, x_a, x_b, sampled=False)
    twist = np.random.default_rng(17).normal(size=6)
    for x, dx in zip((x_a, x_b), slip_velocities(slip, x_a, x_b, twist, twist), strict=True):
        np.testing.assert_allclose(dx, twist[:3] + np.cross(twist[3:], x), atol=1e-12)
    # One body alone takes them along by a share.
    slide = np.array([0.5, -0.7, 0.0, 0.0, 0.0, 0.0])
    dx_a, dx_b = slip_velocities(slip, x_a, x_b, 0.0 * slide, slide)
    shares = np.concatenate([dx_a[:2], dx_b[:2]]) / np.tile(slide[:2], 2)
    assert ((shares > 0.3) & (shares < 0.7)).all()


def test_contracted_slips_are_symmetric_with_eigenvalues_from_0_to_1() -> None:
    rng = np.random.default_rng(13)
    M = rng.normal(size=(200, 3, 3))
    found = contract(M)
    np.testing.assert_allclose(found, found.mT, atol=1e-15)
    values = np.linalg.eigvalsh(found)
    assert values.min() > -1e-8 and values.max() < 1 - 0.9e-6
    # Clipped along the eigenvectors of the symmetric part, which stay.
    old, vectors = np.linalg.eigh(0.5 * (M + M.mT))
    expected = (vectors * old.clip(0, 1 - 1e-6)[:, None]) @ vectors.mT
    np.testing.assert_allclose(found, expected, atol=1e-8)
    np.testing.assert_allclose(contract(found), found, atol=1e-12)
