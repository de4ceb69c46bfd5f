"""Poses as people write them: x, y, z in metres and roll, pitch, yaw in degrees, as in URDF."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_so3, transform

MAX_DISTANCE_M = 100.0
"""Largest distance of such a pose in metres, beyond which it is taken for one in millimetres."""


def transform_from_rpy(values: Sequence[float]) -> Float[np.ndarray, "4 4"]:
    """Return the transform (4, 4) of x, y, z (m), roll, pitch, yaw (degrees): Rz(yaw) Ry(pitch) Rx(roll), as in URDF.

    Raises:
        GraspRefineError: these are not three or six finite numbers, or farther than `MAX_DISTANCE_M`.
    """
    numbers = [float(value) for value in values]
    if len(numbers) not in (3, 6) or not np.isfinite(numbers).all():
        listed = ", ".join(f"{value:g}" for value in numbers)
        raise GraspRefineError(
            f"a pose has 3 or 6 finite numbers, x y z in metres, roll pitch yaw in degrees: {listed}"
        )
    if np.abs(numbers[:3]).max() > MAX_DISTANCE_M:
        raise GraspRefineError(f"a pose is in metres, {max(numbers[:3], key=abs):g} is farther than {MAX_DISTANCE_M:g}")
    roll, pitch, yaw = np.deg2rad([*numbers[3:], 0.0, 0.0, 0.0][:3])
    x, y, z = np.eye(3)
    return transform(exp_so3(yaw * z) @ exp_so3(pitch * y) @ exp_so3(roll * x), np.array(numbers[:3]))


def rpy_from_transform(T: Float[np.ndarray, "4 4"]) -> list[float]:
    """Return x, y, z (m), roll, pitch, yaw (degrees) of a transform (4, 4), for `transform_from_rpy`."""
    R = T[:3, :3]
    flat = np.hypot(R[0, 0], R[1, 0])
    yaw = np.arctan2(R[1, 0], R[0, 0]) if flat > 1e-9 else 0.0
    roll = np.arctan2(R[2, 1], R[2, 2]) if flat > 1e-9 else np.arctan2(-R[1, 2], R[1, 1])
    angles = np.rad2deg([roll, np.arctan2(-R[2, 0], flat), yaw])
    return [float(value) + 0.0 for value in (*T[:3, 3], *angles)]


def read_pose(text: str, option: str) -> Float[np.ndarray, "4 4"]:
    """Return the transform (4, 4) that a text such as "0.5,0,0.2,0,0,90" gives.

    Args:
        text: Three or six numbers with commas between them: metres, then degrees.
        option: Name of the argument, for the message.

    Raises:
        GraspRefineError: the text is no pose.
    """
    try:
        return transform_from_rpy([float(part) for part in text.split(",")])
    except ValueError:
        raise GraspRefineError(
            f"{option} {text}: a pose is x,y,z in metres, or x,y,z,roll,pitch,yaw with angles in degrees, as in "
            "0.5,0,0.2,0,0,90"
        ) from None
    except GraspRefineError as error:
        raise GraspRefineError(f"{option} {text}: {error}") from None
