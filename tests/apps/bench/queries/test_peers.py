"""The peers are asked what we are asked: their distances are ours, in every state, but for their tolerances."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from grasp_refine.collision.query import query
from grasp_refine_apps.bench.queries.bodies import make_pairs
from grasp_refine_apps.bench.queries.cases import STATE_DISTANCES_M, Case, State
from grasp_refine_apps.bench.queries.peers import PEERS, Peer
from grasp_refine_apps.bench.queries.poses import draw_poses


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
@pytest.mark.parametrize("state", get_args(State))
@pytest.mark.parametrize("case", [Case(vertices=128), Case("concave", 4)], ids=["convex", "concave"])
def test_distances_of_peers_are_ours(case: Case, state: State, peer: Peer):
    pairs = make_pairs(case, 0)
    T_a, T_b = draw_poses(pairs, STATE_DISTANCES_M[state], 16, 1)
    # MuJoCo keeps vertices in single precision, 6e-9 m at 0.1 m.
    np.testing.assert_allclose(peer.loop(pairs, T_a, T_b)(), query(pairs, T_a, T_b).distance[:, 0], rtol=0, atol=1e-7)


def test_their_own_tolerances_are_told():
    assert {peer.name: peer.tolerance_m for peer in PEERS} == {"coal-fresh": 1e-6, "coal-reused": 1e-9, "mujoco": 1e-6}
