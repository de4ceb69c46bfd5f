"""Which link should touch the object where, when nobody says."""

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.se3 import inverse, transform_points

REACH = 0.03
"""Contact links farther from the object than this (metres) are not meant to touch it."""


def automatic_targets(
    witness: Witness, T_world_a: np.ndarray, T_world_b: np.ndarray, reach: float = REACH
) -> tuple[np.ndarray, np.ndarray]:
    """The present witness points of all pairs within reach as targets, in the bodies' frames.

    Args:
        witness: Witness points of contact links (a) and object (b).
        T_world_a: Poses of the links (batch, pair, 4, 4).
        T_world_b: Poses of the object (batch, pair, 4, 4).
        reach: Largest signed distance in metres at which a link counts as meant to touch.

    Returns:
        Points on the links and on the object (batch, pair, 3) in metres, NaN for pairs out of reach.
    """
    near = (witness.valid & (witness.distance <= reach))[..., None]
    on_a = transform_points(inverse(T_world_a), witness.point_a)
    on_b = transform_points(inverse(T_world_b), witness.point_b)
    return np.where(near, on_a, np.nan), np.where(near, on_b, np.nan)
