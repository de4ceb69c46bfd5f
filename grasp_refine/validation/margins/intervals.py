"""Confidence intervals of shares and of their differences, over draws that all grasps share."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Bool

Z_95 = 1.959963984540054
"""Quantile of the normal distribution for intervals of 95 %."""


def wilson(held: np.ndarray, count: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Return the interval of 95 % of the probability that gave `held` of `count` (Wilson, JASA 1927): lower, upper.

    Never empty: 0 of 32 gives 0 to 0.107. As draws are spread evenly, it is rather too wide than too narrow.
    """
    held, count = np.asarray(held, dtype=float), np.asarray(count, dtype=float)
    share, z2 = held / count, Z_95**2
    middle = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = Z_95 / (1 + z2 / count) * np.sqrt(share * (1 - share) / count + z2 / (4 * count**2))
    return np.where(held == 0, 0.0, middle - half), np.where(held == count, 1.0, middle + half)


def mean_interval(held: Bool[np.ndarray, "N K"]) -> tuple[float, float, float]:
    """Return the mean share of N grasps held in K shared draws with its interval of 95 %: mean, lower, upper.

    It is the interval of `wilson` for as many independent trials as have the variance of the mean over the draws: from
    K, where all grasps are lost in the same draws, to N K. It states how much other draws would change the mean of
    these grasps.
    """
    count, draws = held.shape
    mean, most = float(held.mean()), float(count * draws)
    variance = held.mean(axis=0).var(ddof=1) / draws if draws > 1 else 0.0
    trials = float(np.clip(mean * (1 - mean) / variance, draws, most)) if variance > 0 else most
    lower, upper = wilson(np.asarray(mean * trials), trials)
    return mean, float(lower) if mean > 0 else 0.0, float(upper) if mean < 1 else 1.0


def difference_interval(before: Bool[np.ndarray, "N K"], after: Bool[np.ndarray, "N K"]) -> tuple[float, float, float]:
    """Return by how much the mean share of N grasps rose in the same K draws, with its interval of 95 %.

    The interval of Bonett and Price (J. Educ. Behav. Stat. 2012) for pairs, over the means of the draws. Two more
    draws, one for and one against, each as large as the largest change of a draw and at least the change of a single
    grasp, keep it from being empty where nothing differs.
    """
    count, draws = before.shape
    change = after.mean(axis=0) - before.mean(axis=0)
    largest = max(np.abs(change).max(), 1 / count)
    middle = change.sum() / (draws + 2)
    variance = ((change**2).sum() + 2 * largest**2) / (draws + 2) - middle**2
    half = Z_95 * np.sqrt(max(variance, 0.0) / (draws + 2))
    mean = float(change.mean())
    return mean, min(mean, float(max(middle - half, -1.0))), max(mean, float(min(middle + half, 1.0)))
