"""Clearance: the gap that links keep from the object which are no contact links."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from grasp_refine.refinement.config import Config

OTHER_MODEL_CLEARANCE_M = 1.5e-3
"""Default clearance, in metres, where grasps are simulated on an MJCF, with other geometry than they are refined on:
its fingers are often thicker between their joints."""


def clearances(config: Config, hand: Hand, chain: Chain) -> Float[np.ndarray, " L"]:
    """Return the gap (L,) in metres that each link keeps from the object where it has no target.

    It is the clearance of the settings for links that move and are neither contact links of the hand nor named as
    such. The palm has none, whatever carries it: it is where the fingers need it.
    """
    tips = {contact.link for contact in hand.contacts} | set(config.contact_selection.named(hand, chain.links))
    moves = chain.moves[:, ~hand.arm_joints].any(axis=1)
    clearance = config.clearance
    if clearance is None:
        simulates_other = (
            hand.collision == "mjcf" and hand.mjcf is not None and hand.mjcf.resolve() != hand.urdf.resolve()
        )
        clearance = OTHER_MODEL_CLEARANCE_M if simulates_other else 0.0
    return np.where(moves & ~np.isin(chain.links, list(tips)), clearance, 0.0)
