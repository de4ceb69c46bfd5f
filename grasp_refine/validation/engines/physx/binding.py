"""SAPIEN's binding of PhysX, without graphics."""

from __future__ import annotations

import warnings

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import pose_from_transform

with warnings.catch_warnings():
    # It looks for a graphics driver, which nothing here needs.
    warnings.simplefilter("ignore")
    from sapien import Entity, Pose, physx
    from sapien.pysapien import Scene

__all__ = ["Entity", "Pose", "Scene", "physx", "pose_of_transform"]


def pose_of_transform(T: Float[np.ndarray, "4 4"]) -> Pose:
    """Return a transform (4, 4) as a pose of PhysX."""
    pose = pose_from_transform(T)
    return Pose(pose[:3], pose[3:])
