"""Where a hand is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a hand is, in the object's frame."""

    T_object_root: Float[np.ndarray, "4 4"]
    """Pose (4, 4) of the base link, metres."""
    q: Float[np.ndarray, " n"]
    """Joint values (n,) in `Hand.joint_names` order; radians, metres for prismatic joints."""

    def same(self, other: Pose) -> bool:
        """Whether the other one is the very same place."""
        return np.array_equal(self.T_object_root, other.T_object_root) and np.array_equal(self.q, other.q)
