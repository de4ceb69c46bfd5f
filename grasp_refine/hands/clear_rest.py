"""Rest pose of a hand without overlapping links, where fingers cross in the middle of their ranges."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.self_collision import finite_limits, self_penetration, touching_pairs

NUM_DRAWS, SEED = 128, 0
"""Number of configurations, uniform within the limits, among which a clear one is looked for, and their seed."""


def clear_rest(hand: Hand) -> Float[np.ndarray, " n"]:
    """Return the rest pose (n,) of a hand or, where links overlap there, one near it in which none do.

    Of random configurations, the nearest clear one is taken, and as many of its joints as possible return to rest.
    Without any clear one, the rest pose is returned as it is.
    """
    pairs = touching_pairs(hand)

    def overlaps(q: Float[np.ndarray, "N n"]) -> np.ndarray:
        return np.asarray(self_penetration(hand, pairs, q) > 0.0)

    rest = hand.rest
    if not overlaps(rest[None])[0]:
        return rest
    lower, upper = finite_limits(hand)
    draws = np.random.default_rng(SEED).uniform(lower, upper, (NUM_DRAWS, len(rest)))
    draws = draws[~overlaps(draws)]
    if not len(draws):
        return rest
    away = np.linalg.norm((draws - rest) / np.maximum(upper - lower, 1e-9), axis=1)
    found = draws[away.argmin()]
    for joint in range(len(rest)):
        back = found.copy()
        back[joint] = rest[joint]
        if not overlaps(back[None])[0]:
            found = back
    return found
