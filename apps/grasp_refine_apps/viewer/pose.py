"""Pose of a hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of a hand in the object's frame."""

    T_object_root: Float[np.ndarray, "4 4"]
    """Pose (4, 4) of the base link, metres."""
    q: Float[np.ndarray, " n"]
    """Joint values (n,) in `Hand.joint_names` order; radians, metres for prismatic joints."""

    def same(self, other: Pose) -> bool:
        """Return whether both poses are equal."""
        return np.array_equal(self.T_object_root, other.T_object_root) and np.array_equal(self.q, other.q)
