"""Set points of squeezes beyond the control range of an actuator, which presses less than planned."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from grasp_refine.closing.motion import Motion
from grasp_refine.core.array_types import Float
from grasp_refine.core.plurals import count_text
from grasp_refine.hands.linkages.servos import actuator_name
from grasp_refine.validation.engines.mujoco.world import World

NEGLIGIBLE_EXCESS = 1e-3
"""Excess of a set point, in rad or m, that is not reported."""

MAX_NAMES = 4
"""Largest number of actuators that are named."""


def set_point_excess(world: World, motion: Motion) -> Float[np.ndarray, "N u"]:
    """Return how far (N, u) the set points of the squeezes lie beyond the ctrlrange of the u actuators; NaN stays.

    The simulation clips them, as the driver of such an actuator does.
    """
    hand, model = world.hand, world.model
    wanted = (motion.q[:, -1] @ hand.matrix.T + hand.offset) @ world.control.T
    low, high = np.where(model.actuator_ctrllimited.astype(bool), model.actuator_ctrlrange.T, [[-np.inf], [np.inf]])
    return np.maximum(np.maximum(low - wanted, wanted - high), 0.0)


def clipping_note(worlds: Sequence[World], motions: Sequence[Motion]) -> str:
    """Return a note on set points of all squeezes that are clipped; empty where none is.

    Args:
        worlds: A world for each object, with the same hand.
        motions: The grasps on each.
    """
    if not worlds:
        return ""
    excess = np.concatenate([set_point_excess(*each) for each in zip(worlds, motions, strict=True)])
    clipped = excess > NEGLIGIBLE_EXCESS
    if not clipped.any():
        return ""
    order = np.argsort(-clipped.sum(axis=0), kind="stable")
    order = order[clipped[:, order].any(axis=0)]
    names = [actuator_name(worlds[0].model, int(number)) for number in order[:MAX_NAMES]]
    if len(order) > MAX_NAMES:
        names.append(f"{len(order) - MAX_NAMES} more")
    count, most = int(clipped.any(axis=1).sum()), np.nanmax(excess)
    return (
        f"{count} of {count_text(len(excess), 'squeeze')}: set points beyond the ctrlrange of "
        f"{', '.join(names)}, by up to {most:.2g}; they are clipped, and press less than planned"
    )
