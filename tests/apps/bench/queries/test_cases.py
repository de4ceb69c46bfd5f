"""Generated bodies and their poses are as their case says, in every run; distances of the peers are ours."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from grasp_refine.collision.query import query
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import inverse, log_so3
from grasp_refine_apps.bench.queries.cases import (
    STATE_DISTANCES_M,
    STEP_DEVIATIONS,
    Case,
    State,
    draw_poses,
    make_body,
    make_pairs,
    nearby,
)
from grasp_refine_apps.bench.queries.peers import PEERS, Peer
from refusals import refused


@pytest.mark.parametrize(("pieces", "vertices"), [(1, 4), (1, 512), (4, 8), (16, 32), (64, 8)])
def test_bodies_have_the_pieces_and_vertices_that_are_asked_for(pieces: int, vertices: int):
    body = make_body(pieces, vertices, 3)
    assert [len(piece.vertices) for piece in body.pieces] == [vertices] * pieces
    again, other = make_body(pieces, vertices, 3), make_body(pieces, vertices, 4)
    for piece, same in zip(body.pieces, again.pieces, strict=True):
        np.testing.assert_array_equal(piece.vertices, same.vertices)
    assert not np.array_equal(body.pieces[0].vertices, other.pieces[0].vertices)


@pytest.mark.parametrize(
    ("case", "piece_pairs"), [(Case("convex"), 1), (Case("mixed", 5), 5), (Case("concave", 5), 25)]
)
def test_piece_pairs_are_as_in_the_bodies(case: Case, piece_pairs: int):
    pairs = make_pairs(case, 0)
    assert case.piece_pairs == piece_pairs == len(pairs.piece_pairs[0])


@pytest.mark.parametrize("state", get_args(State))
@pytest.mark.parametrize("case", [Case(), Case("concave", 4)], ids=["convex", "concave"])
def test_bodies_are_as_far_apart_as_the_state_says(case: Case, state: State):
    pairs, wanted = make_pairs(case, 0), STATE_DISTANCES_M[state]
    T_a, T_b = draw_poses(pairs, wanted, 12, 5)
    assert T_a.shape == T_b.shape == (12, 1, 4, 4)
    tolerance = 1e-9 if wanted >= 0 else 0.1 * abs(wanted) + 1e-9
    np.testing.assert_allclose(query(pairs, T_a, T_b).distance, wanted, rtol=0, atol=tolerance)
    again = draw_poses(pairs, wanted, 12, 5)
    np.testing.assert_array_equal(T_b, again[1])
    # In all directions.
    turned = np.linalg.norm(log_so3((inverse(T_a) @ T_b)[:, 0, :3, :3]), axis=1)
    assert np.ptp(turned) > 0.5


def test_depths_that_no_pose_has_are_refused():
    with refused(GraspRefineError, "-100 mm"):
        draw_poses(make_pairs(Case(vertices=8), 0), -0.1, 2, 0)


def test_nearby_poses_are_a_step_away():
    T = np.tile(np.eye(4), (400, 1, 1, 1))
    moved = nearby(T, 1)
    assert not np.array_equal(moved, T) and np.array_equal(T, np.tile(np.eye(4), (400, 1, 1, 1)))
    assert moved[:, 0, :3, 3].std() == pytest.approx(STEP_DEVIATIONS[0], rel=0.1)
    assert log_so3(moved[:, 0, :3, :3]).std() == pytest.approx(STEP_DEVIATIONS[1], rel=0.1)


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
@pytest.mark.parametrize("state", get_args(State))
@pytest.mark.parametrize("case", [Case(vertices=128), Case("concave", 4)], ids=["convex", "concave"])
def test_distances_of_peers_are_ours(case: Case, state: State, peer: Peer):
    pairs = make_pairs(case, 0)
    T_a, T_b = draw_poses(pairs, STATE_DISTANCES_M[state], 16, 1)
    # MuJoCo keeps vertices in single precision, 6e-9 m at 0.1 m.
    np.testing.assert_allclose(peer.loop(pairs, T_a, T_b)(), query(pairs, T_a, T_b).distance[:, 0], rtol=0, atol=1e-7)
