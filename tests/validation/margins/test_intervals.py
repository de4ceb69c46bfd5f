"""Confidence intervals against published numbers, and against how often they contain the truth."""

import statistics

import numpy as np
import pytest

from grasp_refine.validation.margins.intervals import difference_interval, mean_interval, wilson


def test_wilson_intervals_of_newcombe_1998() -> None:
    # Table I of Newcombe, "Two-sided confidence intervals for the single proportion", method 3.
    lower, upper = wilson(np.array([81, 15, 0, 1]), np.array([263, 148, 20, 29]))
    np.testing.assert_allclose(lower, [0.2553, 0.0624, 0.0, 0.0061], atol=5e-5)
    np.testing.assert_allclose(upper, [0.3662, 0.1605, 0.1611, 0.1718], atol=5e-5)


def test_the_interval_of_a_mean_is_that_of_as_many_trials_as_have_its_variance() -> None:
    """From the draws, where all grasps are lost together, to all trials, where they are lost apart."""
    held = np.random.default_rng(0).uniform(size=(5, 16)) < np.linspace(0.3, 0.9, 16)
    mean, low, high = mean_interval(held)
    variance = statistics.variance(held.mean(axis=0).tolist()) / 16
    trials = mean * (1 - mean) / variance
    assert mean == held.mean() and 16 < trials < 80
    np.testing.assert_allclose([low, high], np.ravel(wilson(np.asarray(mean * trials), trials)), rtol=1e-12)
    together, apart = ((np.arange(32) + step * np.arange(20)[:, None]) % 4 > 0 for step in (0, 1))
    for case, trials in ((together, 32), (apart, 640)):
        expected = np.ravel(wilson(np.asarray(0.75 * trials), trials))
        np.testing.assert_allclose(mean_interval(case)[1:], expected, rtol=1e-12)
    for none_or_all in (np.zeros((3, 8), dtype=bool), np.ones((3, 8), dtype=bool)):
        expected = np.ravel(wilson(np.asarray(none_or_all.sum()), 24))
        np.testing.assert_allclose(mean_interval(none_or_all)[1:], expected)
        assert np.ptp(expected) > 0.1, "no certainty"


@pytest.mark.parametrize("grasps", [1, 5])
def test_the_interval_of_a_difference_counts_one_more_draw_for_and_one_against(grasps: int) -> None:
    """As large as the largest change: with these, mean and variance over the draws give it; it turns with the order."""
    common = np.random.default_rng(2).uniform(size=32)
    before, after = (common < np.linspace(low, low + 0.1, grasps)[:, None] for low in (0.5, 0.75))
    found, low, high = difference_interval(before, after)
    change = (after.mean(axis=0) - before.mean(axis=0)).tolist()
    draws = [*change, max(map(abs, change)), -max(map(abs, change))]
    half = 1.959963984540054 * statistics.pstdev(draws) / np.sqrt(len(draws))
    middle = statistics.fmean(draws)
    assert found == pytest.approx(statistics.fmean(change)) and low < 0.2 < high
    assert [low, high] == pytest.approx([min(found, middle - half), max(found, middle + half)], rel=1e-12)
    assert difference_interval(after, before) == pytest.approx((-found, -high, -low))
    # Where nothing differs, a single grasp's change keeps it from being empty.
    _, low, high = difference_interval(before, before)
    assert [-low, high] == pytest.approx([1.959963984540054 / grasps * np.sqrt(2) / 34] * 2)
