"""The search among piece pairs: what is left after a bound, and in what order; and what a limit hides."""

import numpy as np
import pytest

from grasp_refine.collision.query import Pairs
from grasp_refine.collision.search import Remaining, Search
from grasp_refine.core.se3 import inverse
from grasp_refine.geometry.body import build_body
from grasp_refine.geometry.pieces import hull
from twists import random_poses


def test_what_is_left_is_below_the_best_of_its_item_sorted_and_in_runs() -> None:
    rng = np.random.default_rng(0)
    bound, best = rng.normal(size=(9, 14)), rng.normal(size=9)
    best[[2, 8]] = -10.0
    left = Remaining.below(best, bound)
    assert set(zip(left.item, left.column, strict=True)) == set(zip(*np.nonzero(bound < best[:, None]), strict=True))
    np.testing.assert_array_equal(left.bound, bound[left.item, left.column])

    other = rng.normal(size=len(left.item))
    raised = left.raised(other, best)
    keep = other < best[left.item]
    np.testing.assert_array_equal(raised.column, left.column[keep])
    np.testing.assert_array_equal(raised.bound, np.maximum(other, left.bound)[keep])

    ordered = raised.ascending()
    active, starts = ordered.runs(9)
    np.testing.assert_array_equal(active, np.unique(raised.item))
    assert starts[0] == 0 and starts[-1] == len(ordered.item)
    for item, start, stop in zip(active, starts[:-1], starts[1:], strict=True):
        assert (ordered.item[start:stop] == item).all()
        np.testing.assert_array_equal(ordered.bound[start:stop], np.sort(raised.bound[raised.item == item]))


@pytest.mark.parametrize("first", ["likeliest", "unlikeliest", "any"])
def test_whichever_piece_pair_is_asked_first_the_minimum_is_the_same(first: str) -> None:
    rng = np.random.default_rng(1)
    bodies = [
        build_body(
            "b", [hull(rng.normal(size=(16, 3)) * 0.01 + c) for c in rng.normal(size=(9, 3)) * 0.04], candidates=16
        )
        for _ in range(2)
    ]
    pairs = Pairs((bodies[0],), (bodies[1],), engine="python")
    T = (inverse(random_poses(50, 1, 0.02)) @ random_poses(50, 2, 0.06))[:, 0]
    R, t = np.ascontiguousarray(T[:, :3, :3]), np.ascontiguousarray(T[:, :3, 3])
    pair = np.zeros(50, dtype=np.int64)
    bound, likeliest = pairs._table.sphere_bound(pair, R, t)
    column = {"likeliest": likeliest, "unlikeliest": bound.argmax(axis=1), "any": rng.integers(81, size=50)}[first]
    every = pairs.narrow_phase.closest(
        np.repeat(R, 81, axis=0), np.repeat(t, 81, axis=0), np.arange(50 * 81 + 1), np.tile(pairs._table.id[0], 50),
        np.full(50 * 81, -np.inf), np.full(50 * 81, np.inf),
    ).distance.reshape(50, 81)  # fmt: skip
    for limit in (np.inf, 0.01, -0.002):
        found = Search(pairs._table, pairs.narrow_phase, pair, R, t, np.full(50, limit)).minimum(bound.copy(), column)
        least = np.where(every.min(axis=1) < limit, every.min(axis=1), np.inf)
        np.testing.assert_allclose(found.distance, least, atol=1e-8)
        np.testing.assert_array_equal(found.winner >= 0, np.isfinite(least))
        assert not found.normal[np.isinf(least)].any()
