"""Modes in which a linkage yields: motions that its closed chains allow while the driven joint stands still.

Adaptive fingers, as in underactuated grippers, have more joints than their chains close. Springs
hold what is left over, and limits of joints against which they press: torques of contact forces beyond these move the
finger, however strong the actuator is (Birglen, Laliberté and Gosselin, "Underactuated Robotic Hands", 2008).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float


@dataclass(frozen=True, eq=False)
class YieldingMode:
    """One mode of a linkage, at K values of its driven joint; its unit is the unit of one of its joints, rad or m."""

    joint: str
    """The passive joint that represents the mode: with a spring, if any has one."""
    driver: str
    """The driven joint."""
    values: Float[np.ndarray, " K"]
    """Increasing values (K,) of the driven joint, in rad or m."""
    twists: Mapping[str, Float[np.ndarray, "K 6"]]
    """Link that the mode moves -> its twist (K, 6), (v, w) in its own frame, per unit of the mode."""
    least: Float[np.ndarray, " K"]
    """Least torque (K,), in N m per rad or N per m of the mode, that springs and limits make; -inf: a limit holds."""
    greatest: Float[np.ndarray, " K"]
    """Greatest torque (K,); inf: a limit holds."""
    stiffness: Float[np.ndarray, " K"]
    """Stiffness (K,) of the springs in the mode."""

    def twist(self, link: str, value: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N 6"]:
        """Return the twist (N, 6) of a link that it moves, in its own frame, at values (N,) of the driven joint."""
        return np.stack([np.interp(value, self.values, column) for column in self.twists[link].T], axis=1)

    def slope(self, link: str, value: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N 6"]:
        """Return the derivative (N, 6) of `twist` by the value of the driven joint."""
        after = np.clip(np.searchsorted(self.values, value), 1, len(self.values) - 1)
        step = (self.values[after] - self.values[after - 1])[:, None]
        known = self.twists[link]
        return (known[after] - known[after - 1]) / step

    def bounds(
        self, value: Float[np.ndarray, " N"], give: float = 0.0
    ) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
        """Return the least and the greatest torque (N,) at values (N,) of the driven joint.

        Args:
            value: Values of the driven joint.
            give: Angle in rad, or length in m, by which the mode may give way before springs make them.
        """
        more = give * np.interp(value, self.values, self.stiffness)
        return _between(value, self.values, self.least) - more, _between(value, self.values, self.greatest) + more


def _between(
    x: Float[np.ndarray, " N"], at: Float[np.ndarray, " K"], bound: Float[np.ndarray, " K"]
) -> Float[np.ndarray, " N"]:
    """Return bounds (N,) between the bounds at some values: the finite one where the other is infinite."""
    finite = np.isfinite(bound)
    if not finite.any():
        return np.full(len(x), bound[0])
    after = np.clip(np.searchsorted(at, x), 1, len(at) - 1)
    both = np.interp(x, at, np.where(finite, bound, 0.0))
    first, second = bound[after - 1], bound[after]
    return np.where(finite[after - 1] & finite[after], both, np.where(finite[after - 1], first, second))
