"""Curvatures of pairs at their witness points: fitted, raised, or those of the exact feature."""

import numpy as np
import pytest

from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.core.se3 import inverse, matvec, tangents
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import box, capsule, hull, sphere
from grasp_refine.witness.pair_curvature import CORNER_CURVATURE_PER_M, PairCurvatures
from twists import poses_at_gap, random_poses

pytestmark = pytest.mark.usefixtures("engine")


def items(pairs: Pairs, gap: float, count: int = 12, seed: int = 1) -> tuple[np.ndarray, np.ndarray, Witness]:
    """Poses (M, 4, 4) and witness points (M,) of one pair."""
    T_a, T_b = poses_at_gap(pairs, count, gap, seed)
    return T_a[:, 0], T_b[:, 0], query(pairs, T_a, T_b).reshape(-1)


def fit(
    pairs: Pairs,
    T_a: np.ndarray,
    T_b: np.ndarray,
    witness: Witness,
    width: float = 1.0,
    miss: float = 0.0,
    smallest: float = 1.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tangents and both curvatures."""
    count, E = len(T_a), tangents(witness.normal)
    misses = np.full((2, count), miss)
    found = PairCurvatures.of(pairs, smallest).fit(
        np.zeros(count, dtype=int), T_a, T_b, witness, E, misses, np.full(count, width)
    )
    return E, *found


def pair(*pieces: object, candidates: int = 1024) -> Pairs:
    return Pairs(*((build_body("body", [piece], candidates=candidates),) for piece in pieces))


@pytest.mark.parametrize("gap", [0.01, -0.004])
def test_balls_seen_by_a_pair_have_their_curvatures(gap: float) -> None:
    pairs = pair(sphere(0.03, (0.01, 0, 0)), sphere(0.02), candidates=8192)
    _, K_a, K_b = fit(pairs, *items(pairs, gap), smallest=0.0)
    np.testing.assert_allclose(0.03 * np.linalg.eigvalsh(K_a), 1.0, atol=0.15)
    np.testing.assert_allclose(0.02 * np.linalg.eigvalsh(K_b), 1.0, atol=0.15)


def test_the_sum_is_at_least_one_over_the_mean_extent() -> None:
    pairs = pair(box([0.08, 0.08, 0.04]), box([0.1, 0.1, 0.02]))
    T = np.eye(4)[None]
    T_b = T.copy()
    T_b[0, :3, 3] = 0.003, 0.004, 0.035
    w = query(pairs, T[:, None], T_b[:, None]).reshape(-1)
    w = Witness(
        *(getattr(w, name) for name in ("point_a", "point_b", "normal", "distance", "status")), w.winner, w.num_queries
    )
    w.point_a[:], w.point_b[:] = [0.001, 0.002, 0.02], [0.001, 0.002, 0.025]
    _, K_a, K_b = fit(pairs, T, T_b, w, smallest=3.0)
    floor = 3.0 / (0.5 * (pairs.a[0].extent + pairs.b[0].extent))
    assert (np.linalg.eigvalsh(K_a + K_b) >= floor * (1 - 1e-9)).all()


def test_the_neighbourhood_grows_with_the_miss() -> None:
    """Near the edge of a box: a wide one sees the edge and is curved, a narrow one on the face is flat."""
    pairs = pair(sphere(0.02), box([0.2, 0.2, 0.2]), candidates=8192)
    T_a, T_b = np.eye(4)[None].copy(), np.eye(4)[None]
    T_a[0, :3, 3] = 0.05, 0.01, 0.125
    w = query(pairs, T_a[:, None], T_b[:, None]).reshape(-1)
    bent = [np.linalg.eigvalsh(fit(pairs, T_a, T_b, w, width, 0.01, 0.0)[2])[0, 1] for width in (0.5, 1.0, 5.0)]
    assert abs(bent[0]) < 0.1 and abs(bent[1]) < 0.1 and bent[2] > 5.0


# features


def features(x: np.ndarray, half: np.ndarray) -> np.ndarray:
    """On how many faces (M,) of a box with half sizes (3,) points lie."""
    return (np.abs(np.abs(x) - half) < 1e-9).sum(axis=1)


@pytest.mark.parametrize("gap", [0.01, -0.002])
def test_without_width_faces_are_flat_edges_bend_across_and_vertices_all_round(gap: float) -> None:
    half = np.array([0.03, 0.04, 0.05])
    pairs = pair(hull(np.random.default_rng(2).normal(size=(12, 3)) * 0.02), box(2 * half))
    T_a, T_b, w = items(pairs, gap, count=60)
    E, _, K_b = fit(pairs, T_a, T_b, w, width=0.0, smallest=0.0)
    x = matvec(inverse(T_b)[:, :3, :3], w.point_b - T_b[:, :3, 3])
    count = features(x, half)
    values = np.linalg.eigvalsh(K_b)
    assert (count >= 1).all() and (np.bincount(count, minlength=4)[1:] > 0).sum() >= 2
    for faces, expected in (
        (1, (0.0, 0.0)),
        (2, (0.0, CORNER_CURVATURE_PER_M)),
        (3, (CORNER_CURVATURE_PER_M, CORNER_CURVATURE_PER_M)),
    ):
        np.testing.assert_allclose(values[count == faces], np.tile(expected, ((count == faces).sum(), 1)), atol=1e-6)
    # Along an edge it slides freely.
    for i in np.flatnonzero(count == 2):
        axis = T_b[i, :3, :3] @ (np.abs(np.abs(x[i]) - half) >= 1e-9)
        np.testing.assert_allclose(K_b[i] @ E[i].T @ axis, 0.0, atol=1e-6)


def test_without_width_a_vertex_of_a_lies_where_a_is() -> None:
    """The two sides are not mixed up: a box's corner over the middle of another box's face."""
    pairs = pair(box([0.02, 0.02, 0.02]), box([0.2, 0.2, 0.2]))
    T_a, T_b = np.eye(4)[None].copy(), np.eye(4)[None]
    # A cube on its corner.
    z = np.ones(3) / np.sqrt(3)
    t = np.linalg.svd(z[None])[2][1:]
    R = np.stack([t[0], np.cross(z, t[0]), z])
    T_a[0, :3, :3], T_a[0, :3, 3] = R, [0.01, 0.02, 0.1 + 0.01 * np.sqrt(3) + 0.004]
    w = query(pairs, T_a[:, None], T_b[:, None]).reshape(-1)
    assert w.distance[0] == pytest.approx(0.004, abs=1e-9)
    _, K_a, K_b = fit(pairs, T_a, T_b, w, width=0.0, smallest=0.0)
    np.testing.assert_allclose(K_a[0], CORNER_CURVATURE_PER_M * np.eye(2), rtol=1e-9)
    np.testing.assert_allclose(K_b[0], 0.0, atol=1e-6)


def test_without_a_finite_radius_the_exact_feature_counts() -> None:
    """A radius of NaN once left curvatures in Python unset."""
    pairs = pair(capsule(0.02, (0, 0, -0.05), (0, 0, 0.05)), box([0.05, 0.06, 0.07]))
    given = items(pairs, 0.005)
    for found, expected in zip(fit(pairs, *given, miss=np.nan), fit(pairs, *given, width=0.0), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("gap", [0.005, 0.0, -0.002])
def test_without_width_round_pieces_keep_their_radius(gap: float) -> None:
    """It once was CORNER_CURVATURE_PER_M d / (r + d): flat at contact, concave in penetration."""
    pairs = pair(sphere(0.03, (0.01, 0, 0)), capsule(0.02, (0, 0, -0.05), (0, 0, 0.05)))
    T_a, T_b, w = items(pairs, gap)
    E, K_a, K_b = fit(pairs, T_a, T_b, w, width=0.0, smallest=0.0)
    np.testing.assert_allclose(K_a, np.tile(np.eye(2) / 0.03, (len(K_a), 1, 1)), rtol=1e-9, atol=1e-6)
    z = T_b[:, :3, 2]
    at = ((w.point_b - T_b[:, :3, 3]) * z).sum(axis=1)
    side = np.abs(at) < 0.0499
    assert side.any() and not side.all()
    axis = (z[:, None] @ E)[:, 0] * side[:, None]
    expected = (np.eye(2) - axis[:, :, None] * axis[:, None, :]) / 0.02
    np.testing.assert_allclose(K_b, expected, atol=1e-4)


# rows


def test_items_do_not_depend_on_each_other_nor_on_their_order() -> None:
    bodies = [
        build_body("rod", [capsule(0.02, (0, 0, -0.05), (0, 0, 0.05))], candidates=256),
        build_body("box", [box([0.05, 0.06, 0.07])], candidates=256),
    ]
    other = build_body("hull", [hull(np.random.default_rng(5).normal(size=(40, 3)) * 0.03)], candidates=256)
    pairs = Pairs.against(bodies, other)
    count = 60
    rng = np.random.default_rng(6)
    which = rng.integers(2, size=count)
    T_a, T_b = random_poses(count, 7)[:, 0], random_poses(count, 8)[:, 0]
    both = query(pairs, np.stack([T_a, T_a], axis=1), np.stack([T_b, T_b], axis=1)).reshape(-1)
    w = both.rows(2 * np.arange(count) + which)
    assert w.valid.all()
    E, miss, width = tangents(w.normal), rng.uniform(0, 0.02, (2, count)), rng.choice([0.0, 0.5, 1.0, 2.0], count)
    curvatures = PairCurvatures.of(pairs, 1.0)
    every = curvatures.fit(which, T_a, T_b, w, E, miss, width)
    for size in (1, 2, 9, 33):
        some = rng.permutation(count)[:size]
        found = curvatures.fit(which[some], T_a[some], T_b[some], w.rows(some), E[some], miss[:, some], width[some])
        for K, K_every in zip(found, every, strict=True):
            np.testing.assert_array_equal(K, K_every[some])
