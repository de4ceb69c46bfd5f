"""Poses of the palm: of the base link, or of the hand that an arm carries."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand


def palm_poses(
    hand: Hand, T_world_root: Float[np.ndarray, "N 4 4"], q: Float[np.ndarray, "N n"]
) -> Float[np.ndarray, "N 4 4"]:
    """Return the poses (N, 4, 4) of the palm of a hand; NaN where joint values of an arm are not finite."""
    if hand.arm is None:
        return T_world_root
    with np.errstate(invalid="ignore"):
        return Chain(hand, [hand.arm.palm])(T_world_root, q).T_world_link[:, 0]
