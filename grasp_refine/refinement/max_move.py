"""Bounds on the movement of a hand from its initial grasp."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from grasp_refine.core.arguments import check_fields
from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_so3, log_so3


@dataclass(frozen=True)
class MaxMove:
    """Largest movement of root and joints from the initial grasp."""

    translation: float = inf
    """Translation of the root, in metres."""
    rotation: float = inf
    """Rotation of the root, in radians."""
    joints: float = inf
    """Movement of each joint, in radians; prismatic joints move by at most `SLIDE_LEVER_M` of it, 0.1 m per radian."""

    def __post_init__(self) -> None:
        """Refuse bounds that are negative or NaN.

        Raises:
            GraspRefineError: names the bound that is below 0 or not a number.
        """
        check_fields(self)
        for name in ("translation", "rotation", "joints"):
            if not getattr(self, name) >= 0.0:
                raise GraspRefineError(f"max move: {name} must be at least 0, got {getattr(self, name):g}")

    def project(
        self,
        T: Float[np.ndarray, "M 4 4"],
        q: Float[np.ndarray, "M n"],
        T_first: Float[np.ndarray, "M 4 4"],
        q_first: Float[np.ndarray, "M n"],
        per_radian: Float[np.ndarray, " n"],
    ) -> tuple[Float[np.ndarray, "M 4 4"], Float[np.ndarray, "M n"]]:
        """Return root poses and joint values within the bounds; values beyond are moved back towards the first.

        `per_radian` is that of the hand.
        """
        most = self.joints * per_radian
        q = np.clip(q, q_first - most, q_first + most)
        if self.translation == inf and self.rotation == inf:
            return T, q
        T = T.copy()
        moved = T[:, :3, 3] - T_first[:, :3, 3]
        T[:, :3, 3] = T_first[:, :3, 3] + _clip_length(moved, self.translation)
        R_first = T_first[:, :3, :3]
        turned = log_so3(T[:, :3, :3] @ R_first.mT)
        short = _clip_length(turned, self.rotation)
        changed = (short != turned).any(axis=1)
        T[changed, :3, :3] = exp_so3(short[changed]) @ R_first[changed]
        return T, q


def _clip_length(vector: Float[np.ndarray, "M 3"], most: float) -> Float[np.ndarray, "M 3"]:
    """Return vectors (M, 3), shortened to at most `most`."""
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    far = length > most
    return np.where(far, most / np.where(far, length, 1.0), 1.0) * vector
