"""Rows of least squares: scaled by the roots of their weights, none lost, what is far left out."""

import numpy as np
import pytest

from grasp_refine.core.se3 import exp_se3
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand, load_hand
from grasp_refine.refinement.solvers.rows import NEAR_DISTANCE_M, JointRows, Linear, LinkRows, stack


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand("allegro", candidates=16)


def stacked(hand: Hand, count: int, *rows: tuple[float, LinkRows | JointRows]) -> tuple[Linear, Chain, object]:
    """The rows on the first 12 links of random hands."""
    rng = np.random.default_rng(9)
    chain = Chain(hand, [link.name for link in hand.links][:12])
    frames = chain(exp_se3(rng.normal(size=(count, 6))), rng.uniform(hand.lower, hand.upper, (count, 16)))
    return stack(rows, count, chain, frames), chain, frames


def test_weights_multiply_squares_and_links_pull_on_their_own_joints(hand: Hand) -> None:
    rng = np.random.default_rng(0)
    r, c = rng.normal(size=(3, 2, 4)), rng.normal(size=(3, 2, 4, 6))
    direct = JointRows(rng.normal(size=(3, 2)), rng.normal(size=(3, 2, 22)))
    linear, chain, frames = stacked(hand, 3, (4.0, direct), (9.0, LinkRows.of(r, c, np.array([5, 7]))))
    np.testing.assert_allclose(linear.residual, np.concatenate([3.0 * r.reshape(3, 8), 2.0 * direct.residual], axis=1))
    expected = chain.to_joint_space(frames, 3.0 * c.reshape(3, 8, 6), np.array([5] * 4 + [7] * 4))
    np.testing.assert_allclose(linear.jacobian, np.concatenate([expected, 2.0 * direct.jacobian], axis=1))
    assert linear.unilateral is None


@pytest.mark.parametrize("partners", [False, True], ids=["one link", "two links"])
def test_one_sided_rows_are_near_and_no_more_than_in_the_fullest_grasp(hand: Hand, partners: bool) -> None:
    rng = np.random.default_rng(1)
    depth = rng.normal(size=(4, 9)) * 0.01 - 0.008
    depth[2], depth[3, :4] = -np.inf, [0.01, -0.001, -0.9 * NEAR_DISTANCE_M, -1.1 * NEAR_DISTANCE_M]
    c = rng.normal(size=(4, 9, 6))
    first, second = (np.arange(9) + 1, np.arange(9) + 3) if partners else (None, None)
    linear, chain, frames = stacked(hand, 4, (4.0, LinkRows.near(depth, c, first, second)))
    near = depth > -NEAR_DISTANCE_M
    most = near.sum(axis=1).max()
    assert linear.residual.shape == (4, most) and linear.unilateral is not None and linear.unilateral.all()
    link = np.arange(9) if first is None else first
    full = chain.to_joint_space(frames, 2.0 * c, link)
    if second is not None:
        full = full - chain.to_joint_space(frames, 2.0 * c, second)
    for m in range(4):
        held = np.flatnonzero(near[m])
        np.testing.assert_allclose(linear.residual[m, : len(held)], 2.0 * depth[m, held])
        np.testing.assert_allclose(linear.jacobian[m, : len(held)], full[m, held], atol=1e-12)
        # What only fills up never becomes positive.
        assert (linear.residual[m, len(held) :] < 0).all() and not linear.jacobian[m, len(held) :].any()


def test_terms_follow_each_other_and_only_some_are_one_sided(hand: Hand) -> None:
    two_sided = LinkRows.of(np.ones((2, 1, 1)), np.ones((2, 1, 1, 6)), np.array([3]))
    one_sided = LinkRows.near(np.array([[-1.0, 0.002], [-1.0, -1.0]]), np.ones((2, 2, 6)))
    paired = LinkRows.near(np.full((2, 1), 0.001), np.ones((2, 1, 6)), np.array([4]), np.array([6]))
    far = LinkRows.near(np.full((2, 5), -0.1), np.ones((2, 5, 6)))
    linear, _, _ = stacked(hand, 2, *((1.0, rows) for rows in (two_sided, one_sided, far, paired)))
    np.testing.assert_array_equal(linear.residual, [[1.0, 0.002, 0.001], [1.0, -NEAR_DISTANCE_M, 0.001]])
    np.testing.assert_array_equal(linear.unilateral, [[False, True, True]] * 2)


def test_nothing_near_adds_nothing(hand: Hand) -> None:
    linear, _, _ = stacked(hand, 3, (100.0, LinkRows.near(np.full((3, 5), -0.1), np.ones((3, 5, 6)))))
    assert linear.residual.shape == (3, 0) and linear.jacobian.shape == (3, 0, 22) and linear.unilateral is None
