"""Slices: together they are the body they come from, and distances to it stay the same."""

from __future__ import annotations

import numpy as np
import pytest

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.se3 import exp_se3
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import capsule, hull, sphere
from grasp_refine_apps.bench.grasp.slicing import can_be_sliced, slice_body
from shapes_for_tests import convex_body, ring_body


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6.0)


@pytest.mark.parametrize("count", [1, 2, 7, 64])
def test_slices_make_up_the_body(count: int):
    body = convex_body(3, 60)
    cut = slice_body(body, count)
    assert len(cut.pieces) == count and cut.candidates is body.candidates
    whole = volume(body.pieces[0].vertices, body.pieces[0].faces)
    assert sum(volume(piece.vertices, piece.faces) for piece in cut.pieces) == pytest.approx(whole, rel=1e-9)
    # No slice is much longer than the others.
    longest = [np.ptp(piece.bounds, axis=0).max() for piece in cut.pieces]
    assert count < 8 or max(longest) < 2.5 * min(longest)
    # A box in two is known.
    halves = slice_body(build_body("box", [hull(np.indices((2, 2, 2)).reshape(3, -1).T * [4.0, 1.0, 1.0])]), 2)
    assert sorted(piece.bounds[:, 0].tolist() for piece in halves.pieces) == [[0.0, 2.0], [2.0, 4.0]]


def test_distances_outside_stay_the_same_and_penetration_gets_shallower():
    body, other = convex_body(3, 60), convex_body(4, 30)
    rng = np.random.default_rng(0)
    T_a, T_b = (exp_se3(rng.normal(size=(200, 1, 6)) * ([0.05] * 3 + [1.0] * 3)) for _ in range(2))
    whole = query(Pairs((body,), (other,)), T_a, T_b).distance
    parts = query(Pairs((slice_body(body, 16),), (other,)), T_a, T_b).distance
    apart = whole > 0
    assert 20 < apart.sum() < 180
    np.testing.assert_allclose(parts[apart], whole[apart], atol=1e-8)
    assert (parts[~apart] >= whole[~apart] - 1e-6).all() and (parts[~apart] <= 1e-7).all()


def test_what_cannot_be_sliced():
    assert can_be_sliced(convex_body(1, 20))
    for body in (
        ring_body(),
        build_body("ball", [sphere(0.02)]),
        build_body("pill", [capsule(0.01, [0, 0, 0], [0, 0, 0.05])]),
    ):
        assert not can_be_sliced(body)
