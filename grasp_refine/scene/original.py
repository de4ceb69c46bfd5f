"""Original of a transferred grasp: where the fingers of another hand touched the object, and from where it came."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float, Shaped
from grasp_refine.core.short_repr import brief


@dataclass(frozen=True, eq=False)
class Original:
    """Contacts of N grasps of another hand, each at the finger that takes its place; k fingers, as `Hand.fingers`."""

    point: Float[np.ndarray, "N k 3"]
    """Contact points (N, k, 3) on the object, object frame, metres; NaN for fingers that take no other's place."""
    normal: Float[np.ndarray, "N k 3"]
    """Outward unit normals (N, k, 3) of the object there; NaN likewise."""
    finger: Shaped[np.ndarray, "N k"]
    """Names (N, k) of the fingers that touched there; empty: none."""
    dropped: Shaped[np.ndarray, " N"]
    """Names (N,) of the fingers that touched and whose place no finger takes, with commas between; empty: none."""
    opposed: Shaped[np.ndarray, "N k"]
    """Mask (N, k) of the thumb, and of the finger that presses against it."""
    approach: Float[np.ndarray, "N 3"]
    """Approach directions (N, 3) of the other hand, from its palm to its fingertips, unit vectors, object frame."""
    own_approach: Float[np.ndarray, "N 3"]
    """Approach direction (N, 3) of the hand itself, frame of its palm; the same for all."""

    __repr__ = brief

    @property
    def span(self) -> Float[np.ndarray, " N"]:
        """Distances (N,) from the thumb's contact to the one that is opposed, metres; NaN where there are no two."""
        apart = np.linalg.norm(self.point[:, :, None] - self.point[:, None], axis=-1)
        both = self.opposed[:, :, None] & self.opposed[:, None]
        return np.where(self.opposed.sum(axis=1) == 2, np.where(both, apart, 0.0).max(axis=(1, 2)), np.nan)
