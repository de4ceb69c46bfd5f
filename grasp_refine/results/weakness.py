"""Texts on what makes grasps weak: the shortcoming that costs most quality, with its push, link, contact or joint."""

from __future__ import annotations

import numpy as np

from grasp_refine.forces.calibration import CALIBRATION
from grasp_refine.forces.quality import (
    DEEP,
    EJECTING,
    LOW_FRICTION,
    MOST_YIELDING,
    SHORTCOMINGS,
    YIELDING_RAD_N,
    Quality,
)
from grasp_refine.scene.demand import Demand

NEGLIGIBLE_COST = 0.5
"""Log odds below which the costliest shortcoming is not reported."""

AXES = "xyz"
"""Names of the axes of the object."""


def weaknesses(
    quality: Quality,
    links: tuple[str, ...],
    joints: tuple[str, ...],
    passive: tuple[str, ...] = (),
    demand: Demand | None = None,
) -> list[str]:
    """Return for each of N grasps a text on its costliest shortcoming; empty where it costs little, or is not known.

    Args:
        quality: Shortcomings of the grasps, in the object's frame.
        links: Names of the links.
        joints: Names of the independent joints.
        passive: Names of the passive joints of the modes in which linkages yield.
        demand: Force and friction of the task; None: of `dexgraspbench`.
    """
    demand, most = demand or Demand(), quality.largest_load()
    costs = CALIBRATION.costs(quality.shortcomings)
    known = np.isfinite(costs).all(axis=1)
    worst = np.where(quality.deep > EJECTING[0], SHORTCOMINGS.index("deep"), np.nan_to_num(costs).argmax(axis=1))
    found = []
    for i, which in enumerate(worst):
        if not known[i]:
            found.append("no forces of its contacts balance")
        elif costs[i, which] < NEGLIGIBLE_COST:
            found.append("")
        else:
            found.append(_text(quality, SHORTCOMINGS[which], i, links, joints, passive, demand))
            if which >= len(SHORTCOMINGS) - 2 and most[i] > 0.0:
                found[-1] = f"carries at most {demand.mass_kg * most[i]:.2g} kg: {found[-1]}"
    return found


def _text(
    quality: Quality,
    shortcoming: str,
    i: int,
    links: tuple[str, ...],
    joints: tuple[str, ...],
    passive: tuple[str, ...],
    demand: Demand,
) -> str:
    """Return the text on a shortcoming of grasp `i`."""
    if shortcoming == "slippery":
        friction, left = LOW_FRICTION * demand.grip, quality.slippery[i]
        return f"with friction {friction:.2g} its forces leave {left:.0%} of the load unbalanced"
    if shortcoming == "pushed":
        return f"weak against pushes, most along {direction_text(quality.weakest_push[i])}"
    if shortcoming == "deep":
        return f"{links[quality.deepest_link[i]]} is {1e3 * DEEP * quality.deep[i]:.1f} mm in the object"
    if shortcoming == "strained":
        needed = 1.0 + quality.strained[i]
        which = int(quality.strained_joint[i])
        if which >= len(joints):
            held = f"{passive[which - len(joints)]}, which no actuator drives, needs {needed:.0%} of the torque"
            return f"against pushes {held} of its spring"
        return f"against pushes {joints[which]} needs {needed:.0%} of the torque that it can make"
    if shortcoming == "yielding":
        share = quality.turn_share[i] / demand.load
        most = " or more" if share >= 1.0 + MOST_YIELDING else ""
        turn = np.degrees(YIELDING_RAD_N) * min(share, 1.0 + MOST_YIELDING)
        return (
            "its contacts are close together, or its joints soft: the object turns by about "
            f"{turn:.1f} degrees{most} for each newton of a push"
        )
    return f"contact of {links[quality.farthest_contact[i]]} is open"


def direction_text(direction: np.ndarray) -> str:
    """Return a unit vector (3,) in words: an axis with its sign where it is near one, else its components."""
    axis = int(np.abs(direction).argmax())
    if abs(direction[axis]) > np.cos(np.radians(10.0)):
        return f"{'-' if direction[axis] < 0 else '+'}{AXES[axis]}"
    return f"({', '.join(f'{value:.1f}' for value in direction)})"
