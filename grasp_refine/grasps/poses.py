"""Poses x y z qw qx qy qz in grasp files: quaternions of length 1."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from grasp_refine.core.array_types import Float

QUATERNION_TOLERANCE = 1e-3
"""Greatest distance from 1 of the norm of a quaternion in a file: rounding to float32 passes, a mix-up does not."""


def unit_poses(
    poses: Float[np.ndarray, "N 7"], what: str, error: Callable[[str], Exception]
) -> Float[np.ndarray, "N 7"]:
    """Poses (N, 7) with unit quaternions, if they are so up to rounding; poses that are not finite are kept.

    Raises:
        Exception: what `error` makes of a message on the first quaternion of poses called `what` that is no unit one.
    """
    finite = np.isfinite(poses).all(axis=1)
    with np.errstate(over="ignore"):
        norm = np.where(finite, np.linalg.norm(np.where(finite[:, None], poses[:, 3:], 0.5), axis=1), 1.0)
    wrong = np.flatnonzero(np.abs(norm - 1.0) > QUATERNION_TOLERANCE)
    if len(wrong):
        raise error(
            f"{what} row {wrong[0]} has no unit quaternion: the norm of its numbers 3 to 6, qw qx qy qz, is "
            f"{norm[wrong[0]]:.6g}"
        )
    return np.concatenate([poses[:, :3], poses[:, 3:] / norm[:, None]], axis=1)


def without_zero_quaternions(poses: Float[np.ndarray, "N 7"]) -> Float[np.ndarray, "N 7"]:
    """Poses (N, 7) with NaN where the quaternion is 0: programs write it for unknown poses."""
    return np.where((poses[:, 3:] == 0.0).all(axis=1, keepdims=True), np.nan, poses)
