"""The collision query against brute force, closed forms and the traps of coal."""

import gc
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.optimize import linprog

from grasp_refine.collision.certified_distance import Answer, PiecePair
from grasp_refine.collision.query import Pairs, QueryStatus, query
from grasp_refine.core.errors import CollisionError
from grasp_refine.core.se3 import exp_so3, transform, transform_points
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.pieces import Piece, box, capsule, hull, sphere
from refusals import refused
from shapes_for_tests import piece_body
from twists import random_poses

pytestmark = pytest.mark.usefixtures("engine")


def cluster(seed: int, pieces: int = 8) -> Body:
    """A concave body of overlapping hulls, long boxes at all angles, spheres and capsules."""
    rng = np.random.default_rng(seed)
    parts: list[Piece] = []
    for index, center in enumerate(rng.normal(size=(pieces, 3)) * 0.04):
        if index % 4 == 0:
            parts.append(sphere(0.012, center))
        elif index % 4 == 1:
            parts.append(capsule(0.006, center, center + rng.normal(size=3) * 0.02))
        elif index % 4 == 2:
            parts.append(box([0.04, 0.008, 0.003], transform(exp_so3(rng.normal(size=3)), center)))
        else:
            parts.append(hull(rng.normal(size=(24, 3)) * 0.012 + center))
    return build_body(f"cluster {seed}", parts, candidates=64)


def scattered(count: int, seed: int, spread: float) -> tuple[np.ndarray, np.ndarray]:
    return random_poses(count, seed, 0.01), random_poses(count, seed + 1, spread)


def brute_force(a: Body, b: Body, T_a: np.ndarray, T_b: np.ndarray) -> np.ndarray:
    """Distances (batch, piece pairs), each piece pair asked on its own."""
    sides = tuple(piece_body(p) for p in a.pieces), tuple(piece_body(q) for q in b.pieces)
    first, second = (tuple(column) for column in zip(*product(*sides), strict=True))
    shape = (len(T_a), len(first), 4, 4)
    return query(Pairs(first, second), np.broadcast_to(T_a, shape), np.broadcast_to(T_b, shape)).distance


@pytest.fixture(scope="module")
def many_pieces() -> tuple[Body, Body]:
    return cluster(3, 12), cluster(4, 10)


@pytest.mark.parametrize("gap", [0.02, 0.0, -1e-3])
def test_bodies_of_many_pieces_get_the_minimum_of_brute_force(many_pieces: tuple[Body, Body], gap: float) -> None:
    a, b = many_pieces
    pairs = Pairs((a,), (b,))
    T_a, T_b = scattered(6, 101, 0.15)
    for _ in range(8):
        w = query(pairs, T_a, T_b)
        T_b[..., :3, 3] += (gap - w.distance)[..., None] * w.normal
    every = brute_force(a, b, T_a, T_b)
    least = every.min(axis=1)
    # Moved along the normal of one piece pair, another one may become the deepest.
    assert (np.abs(least - gap) < 1e-6).mean() > 0.5
    nearby = T_b.copy()
    nearby[..., :3, 3] += 2e-3
    for previous in (None, query(pairs, T_a, nearby)):
        found = query(pairs, T_a, T_b, previous=previous)
        np.testing.assert_allclose(found.distance[:, 0], least, atol=1e-8)
        np.testing.assert_allclose(every[np.arange(6), found.winner[:, 0]], least, atol=1e-8)
        assert found.num_queries.max() < 0.2 * every.shape[1]
        for cutoff in (gap + 1e-3, gap - 1e-3):
            cut = query(pairs, T_a, T_b, cutoff=cutoff, previous=previous)
            near = least < cutoff
            np.testing.assert_array_equal(cut.valid[:, 0], near)
            np.testing.assert_allclose(cut.distance[:, 0], np.where(near, least, cutoff), atol=1e-8)
            assert not cut.point_a[~near].any() and not cut.normal[~near].any() and (cut.winner[~near] == -1).all()


def test_nothing_is_below_a_cutoff_that_is_no_number() -> None:
    T_a, T_b = scattered(5, 3, 0.1)
    cutoff = np.full((5, 2), np.inf)
    cutoff[[0, 3], [0, 1]] = cutoff[4] = np.nan
    pairs = Pairs((cluster(0), piece_body(sphere(0.01))), (cluster(1), piece_body(sphere(0.01))))
    T_a, T_b = (np.tile(T, (1, 2, 1, 1)) for T in (T_a, T_b))
    found, hidden = query(pairs, T_a, T_b, cutoff=cutoff), np.isnan(cutoff)
    assert (found.status[hidden] == QueryStatus.FAR).all() and np.isnan(found.distance[hidden]).all()
    assert (
        not found.num_queries[hidden].any() and (found.winner[hidden] == -1).all() and not found.point_a[hidden].any()
    )
    np.testing.assert_array_equal(found.distance[~hidden], query(pairs, T_a, T_b).distance[~hidden])


def test_bodies_are_kept_alive_and_normals_are_copies() -> None:
    pairs = Pairs((cluster(0),), (cluster(1),))
    T_a, T_b = scattered(20, 37, 0.1)
    first = query(pairs, T_a, T_b)
    kept = first.normal.copy()
    gc.collect()
    again = query(pairs, T_a, T_b)
    query(pairs, T_b, T_a)
    np.testing.assert_array_equal(first.normal, kept)
    np.testing.assert_array_equal(again.distance, first.distance)


@pytest.mark.parametrize("engine", ["python"], indirect=True)
def test_without_a_first_answer_the_other_pieces_are_asked_all_the_same(
    many_pieces: tuple[Body, Body], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its normal, which would rule most of them out, is missing then."""
    pairs = Pairs(*((body,) for body in many_pieces))
    T_a, T_b = scattered(1, 111, 0.05)
    whole = query(pairs, T_a, T_b)
    answers: list[float] = []
    first: list[PiecePair] = []
    distance = PiecePair.distance

    def none_at_first(piece_pair: PiecePair, *arguments: object) -> Answer:
        answer = distance(piece_pair, *arguments)
        answers.append(answer.distance)
        first.append(piece_pair)
        return replace(answer, distance=np.nan) if piece_pair is first[0] else answer

    monkeypatch.setattr(PiecePair, "distance", none_at_first)
    found = query(pairs, T_a, T_b)
    assert found.status.item() == QueryStatus.FAILED and np.isnan(found.distance).all()
    assert whole.num_queries.item() <= found.num_queries.item() < len(pairs.piece_pairs[0])
    assert min(answers) == pytest.approx(whole.distance.item(), abs=1e-8)


def test_pairs_need_two_sides_of_equal_length() -> None:
    body = piece_body(sphere(0.01))
    with refused(CollisionError, "1 and 2"):
        Pairs((body,), (body, body))


def test_separated_distance_agrees_with_a_linear_program() -> None:
    """Apart exactly if a separating plane exists: an independent check of the sign."""
    rng = np.random.default_rng(6)
    p, q = (hull(rng.normal(size=(15, 3)) * 0.02) for _ in range(2))
    T_a, T_b = scattered(60, 41, 0.05)
    w = query(Pairs((piece_body(p),), (piece_body(q),)), T_a, T_b)
    for i in range(60):
        a, b = transform_points(T_a[i], p.vertices), transform_points(T_b[i], q.vertices)
        if abs(w.distance[i, 0]) < 1e-6:
            continue
        rows = np.concatenate([np.c_[a, -np.ones(len(a))], np.c_[-b, np.ones(len(b))]])
        separable = (
            linprog(np.zeros(4), rows, -1e-7 * np.ones(len(rows)), bounds=[(-1, 1)] * 3 + [(None, None)]).status == 0
        )
        assert separable == (w.distance[i, 0] > 0)


def test_pieces_with_one_centre_are_not_forgotten() -> None:
    """Two boxes about one point have no line between their centres; its bound once read 0 for a depth of 35 mm."""

    def rod(z: float, *extents: float) -> Piece:
        T = np.eye(4)
        T[2, 3] = z
        return box(extents, T)

    # The rods overlap by 1 mm and, with the larger balls, are asked first.
    a = build_body("a", [box([0.04] * 3), rod(0.05, 0.3, 0.004, 0.004)], candidates=16)
    b = build_body("b", [box([0.03] * 3), rod(0.053, 0.004, 0.3, 0.004)], candidates=16)
    here = np.eye(4)[None, None]
    found = query(Pairs((a,), (b,)), here, here)
    assert found.distance.item() == pytest.approx(-0.035, abs=1e-8)
    assert found.num_queries.item() in (2, 3)


def test_an_empty_batch_has_an_empty_answer() -> None:
    for pairs in (Pairs((cluster(0),), (cluster(1),)), Pairs((piece_body(sphere(0.01)),), (piece_body(sphere(0.01)),))):
        nothing = np.zeros((0, 1, 4, 4))
        found = query(pairs, nothing, nothing)
        assert found.distance.shape == (0, 1) and found.point_a.shape == (0, 1, 3)
        assert query(pairs, nothing, nothing, cutoff=0.01, previous=found).valid.shape == (0, 1)


def test_pairs_of_bodies_with_other_numbers_of_pieces_do_not_disturb_each_other() -> None:
    bodies = [
        cluster(0, 8),
        piece_body(sphere(0.02)),
        cluster(1, 3),
        piece_body(capsule(0.01, (0, 0, 0), (0.05, 0, 0))),
    ]
    a, b = (bodies[0], bodies[1], bodies[2], bodies[3]), (bodies[2], bodies[0], bodies[2], bodies[1])
    together = Pairs(a, b)
    T_a, T_b = (np.concatenate([random_poses(30, 4 * seed + p, 0.05) for p in range(4)], axis=1) for seed in (1, 2))
    found = query(together, T_a, T_b)
    for p in range(4):
        alone = query(Pairs(a[p : p + 1], b[p : p + 1]), T_a[:, p : p + 1], T_b[:, p : p + 1])
        np.testing.assert_allclose(found.distance[:, p : p + 1], alone.distance, atol=1e-12)
        np.testing.assert_array_equal(found.winner[:, p : p + 1], alone.winner + together.first_piece_pair[p])
        pieces_a, pieces_b = together.piece_pairs
        assert all(pieces_a[w] in a[p].pieces and pieces_b[w] in b[p].pieces for w in found.winner[:, p])


def test_every_pair_and_item_may_have_a_cutoff_of_its_own() -> None:
    pairs = Pairs((cluster(0), cluster(0)), (cluster(1), piece_body(sphere(0.02))))
    T_a, T_b = (np.concatenate([random_poses(80, seed + p, 0.06) for p in range(2)], axis=1) for seed in (51, 61))
    full = query(pairs, T_a, T_b)
    for cutoff in (np.array([0.02, -np.inf]), np.random.default_rng(0).uniform(-0.03, 0.05, (80, 2))):
        found = query(pairs, T_a, T_b, cutoff=cutoff)
        limit = np.broadcast_to(cutoff, (80, 2))
        near = full.distance < limit
        assert near.any() and not near.all()
        # What is deeper than the cutoff is found in full, apart and in penetration.
        np.testing.assert_array_equal(found.valid, near)
        np.testing.assert_allclose(found.distance[near], full.distance[near], atol=1e-8)
        np.testing.assert_array_equal(found.distance[~near], limit[~near])
        assert (found.status[~near] == QueryStatus.FAR).all()
        assert (found.num_queries[:, 1] == 0).all() == np.isinf(limit).any()


def test_an_answer_from_elsewhere_as_the_last_one_does_no_harm() -> None:
    pairs = Pairs((cluster(0),), (cluster(1),))
    near, far = scattered(60, 71, 0.03), scattered(60, 81, 0.2)
    T = np.full((60, 1, 4, 4), np.nan)
    wrong = [query(pairs, *far), query(pairs, *near), query(pairs, T, T), query(pairs, *far, cutoff=0.0)]
    for T_a, T_b in (near, far):
        cold = query(pairs, T_a, T_b)
        for previous in wrong:
            warm = query(pairs, T_a, T_b, previous=previous)
            np.testing.assert_allclose(warm.distance, cold.distance, atol=1e-8)
            np.testing.assert_array_equal(warm.status, cold.status)
