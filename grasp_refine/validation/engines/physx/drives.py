"""Drives of PhysX's joints in place of the servos, springs and dampers of MuJoCo's."""

from __future__ import annotations

from math import inf

import numpy as np

from grasp_refine.core.array_types import Float


class Drives:
    """Drives of n joints under u set points; PhysX has one for a joint, and treats it implicitly.

    A drive makes the force clip(K (target - q) - D q', -F, F). Servos, springs and dampers of a joint add up: K is the
    sum of their stiffness, and the target the mean of theirs, weighted by stiffness. F limits all of them together.
    """

    def __init__(self, joints: int, set_points: int) -> None:
        """Begin without any."""
        self.stiffness = np.zeros(joints)
        """Stiffness K (n,), N/m or N m/rad."""
        self.damping = np.zeros(joints)
        """Damping D (n,), N s/m or N m s/rad."""
        self.limit = np.full(joints, inf)
        """Largest force F (n,), N or N m."""
        self._by_set_point = np.zeros((joints, set_points))
        self._at_rest = np.zeros(joints)
        self.servos = np.zeros(joints, dtype=int)
        """Number of servos (n,) of each joint; one that has a limit must be the only one."""

    def add_spring(self, joint: int, stiffness: float, damping: float, rest: float = 0.0) -> None:
        """Add a spring that is relaxed at `rest`, m or rad, and a damper."""
        self.stiffness[joint] += stiffness
        self.damping[joint] += damping
        self._at_rest[joint] += stiffness * rest

    def add_servo(
        self, joint: int, set_point: int, stiffness: float, damping: float, limit: float, gear: float
    ) -> None:
        """Add a servo with stiffness, damping and limit at the joint; its set point is `gear` times the joint's."""
        self.limit[joint] = min(self.limit[joint], limit)
        self.servos[joint] += 1
        self.stiffness[joint] += stiffness
        self.damping[joint] += damping
        self._by_set_point[joint, set_point] += stiffness / gear

    def targets(self, control: Float[np.ndarray, "N u"]) -> Float[np.ndarray, "N n"]:
        """Return the targets (N, n) of the joints for set points (N, u)."""
        # One by one, so that rounding does not depend on the batch.
        force = np.array([self._by_set_point @ row for row in control]).reshape(len(control), -1) + self._at_rest
        return np.divide(force, self.stiffness, out=np.zeros_like(force), where=self.stiffness > 0)
