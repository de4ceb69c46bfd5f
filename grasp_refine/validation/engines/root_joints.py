"""Joints that hold the root of a hand: they slide along the axes of its start, then turn about them."""

from __future__ import annotations

import numpy as np

from grasp_refine.core.array_types import Float

ROOT_LAG_S = 0.038
"""Time by which the root follows a moving set point: that of MuJoCo's weld, 2 x 0.95 x 0.02 s."""

ROOT_STIFFNESS = (1e6, 1e5)
"""Stiffness with which the root is held on its course, N/m and N m/rad: as good as rigid, by any protocol."""


def root_values(start: Float[np.ndarray, "4 4"], T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, " 6"]:
    """Return the values (6,) of the root's joints that take it from `start` to `T`: rotations about x, y, z in turn."""
    R = start[:3, :3].T @ T[:3, :3]
    turns = np.arctan2(-R[1, 2], R[2, 2]), np.arcsin(np.clip(R[0, 2], -1.0, 1.0)), np.arctan2(-R[0, 1], R[0, 0])
    return np.array([*(start[:3, :3].T @ (T[:3, 3] - start[:3, 3])), *turns])
