"""Confidence intervals against published numbers, and against how often they contain the truth."""

import numpy as np
import pytest

from grasp_refine.validation.margins.intervals import difference_interval, mean_interval, wilson


def test_wilson_intervals_of_newcombe_1998() -> None:
    # Table I of Newcombe, "Two-sided confidence intervals for the single proportion", method 3.
    lower, upper = wilson(np.array([81, 15, 0, 1]), np.array([263, 148, 20, 29]))
    np.testing.assert_allclose(lower, [0.2553, 0.0624, 0.0, 0.0061], atol=5e-5)
    np.testing.assert_allclose(upper, [0.3662, 0.1605, 0.1611, 0.1718], atol=5e-5)


def test_none_and_all_are_no_certainty() -> None:
    lower, upper = wilson(np.array([0, 32]), 32)
    assert lower[0] == 0.0 and 0.1 < upper[0] < 0.11
    assert 0.89 < lower[1] < 0.9 and upper[1] == 1.0
    assert mean_interval(np.zeros((3, 8), dtype=bool))[2] > 0.0
    assert mean_interval(np.ones((3, 8), dtype=bool))[1] < 1.0
    _, low, high = difference_interval(np.ones((1, 8), dtype=bool), np.ones((1, 8), dtype=bool))
    assert low < 0.0 < high


def test_of_one_grasp_the_mean_has_wilsons_interval() -> None:
    held = np.arange(32)[None] % 4 > 0
    assert mean_interval(held) == pytest.approx((0.75, *map(float, wilson(np.asarray(24), 32))), abs=0.01)


def correlated(rng: np.random.Generator, grasps: int, draws: int, levels: np.ndarray) -> np.ndarray:
    """Grasps that hold where a common number of each draw is below a level of their own."""
    return rng.uniform(size=draws)[None] < levels[:grasps, None]


def test_means_of_grasps_that_fail_together_are_as_uncertain_as_their_draws() -> None:
    rng, truth = np.random.default_rng(0), 0.75
    inside, width = [], []
    for _ in range(400):
        _, low, high = mean_interval(correlated(rng, 20, 32, np.full(20, truth)))
        inside.append(low <= truth <= high)
        width.append(high - low)
    assert np.mean(inside) > 0.92
    # That of 32 trials, not that of 640.
    assert np.mean(width) > 0.25


def test_means_of_grasps_that_fail_apart_are_more_certain() -> None:
    rng, truth = np.random.default_rng(1), 0.75
    inside, width = [], []
    for _ in range(400):
        _, low, high = mean_interval(rng.uniform(size=(20, 32)) < truth)
        inside.append(low <= truth <= high)
        width.append(high - low)
    assert np.mean(inside) > 0.9
    assert np.mean(width) < 0.1


@pytest.mark.parametrize("grasps", [1, 20])
def test_differences_in_the_same_draws_contain_the_truth_and_are_narrower_than_apart(grasps: int) -> None:
    rng = np.random.default_rng(2)
    before, after = np.full(grasps, 0.6), np.full(grasps, 0.8)
    inside, width = [], []
    for _ in range(400):
        common = rng.uniform(size=32)
        found, low, high = difference_interval(common[None] < before[:, None], common[None] < after[:, None])
        assert low <= found <= high
        inside.append(low <= 0.2 <= high)
        width.append(high - low)
    assert np.mean(inside) > 0.92
    apart = 2 * 1.96 * np.sqrt((0.6 * 0.4 + 0.8 * 0.2) / 32)
    assert np.mean(width) < 0.75 * apart


def test_a_difference_turns_its_sign_with_the_order() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.uniform(size=(2, 5, 16)) < 0.5
    one, two = difference_interval(a, b), difference_interval(b, a)
    assert one == pytest.approx((-two[0], -two[2], -two[1]))
