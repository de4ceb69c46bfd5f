"""Calibration of the quality: probability that a grasp holds, from its shortcomings.

A logistic regression on grasps that were simulated under the protocol `dexgraspbench`. The authoring script
`calibrate_quality` prints its coefficients, and the reliability on hands and generators that were left out of the fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float


@dataclass(frozen=True)
class Calibration:
    """Logistic model of holding: log odds = `offset` minus the weighted square roots of the shortcomings."""

    offset: float
    """Log odds of a grasp without shortcomings."""
    weights: tuple[float, ...]
    """Weight of the square root of each of the K shortcomings, at least 0."""

    def costs(self, shortcomings: Float[np.ndarray, "N K"]) -> Float[np.ndarray, "N K"]:
        """Return the log odds (N, K) that each shortcoming costs."""
        return np.array(self.weights) * np.sqrt(shortcomings)

    def probability(self, shortcomings: Float[np.ndarray, "N K"]) -> Float[np.ndarray, " N"]:
        """Return the probability (N,) that a grasp holds; NaN where a shortcoming is not known."""
        odds = self.offset - self.costs(shortcomings).sum(axis=1)
        with np.errstate(over="ignore"):
            return np.asarray(1.0 / (1.0 + np.exp(-odds)))


CALIBRATION = Calibration(offset=7.28, weights=(4.17, 8.83, 1.07, 1.53, 6.9, 2.04))
"""Fit of all sets, for `slippery`, `pushed`, `deep`, `open`, `strained` and `yielding` of `Quality`."""
