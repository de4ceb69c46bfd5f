"""Support: the plane around an object in depth pictures, on which it stands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from grasp_refine.core.array_types import Bool, Float
from grasp_refine.scans.cleaning import fitted_plane
from grasp_refine.scans.depth_camera import Intrinsics, points_of_depth
from grasp_refine.scans.scan import Plane

AROUND = 0.5
"""Width of the strip around the mask that is looked at, over the larger side of the mask."""

MAX_POINTS = 4000
"""Points that are used; more are thinned."""

TRIES = 100
"""Planes through three points that are tried."""

LEAST_SHARE = 0.4
"""Least share of the points around the object that lie in the plane."""

ABOVE = 0.95
"""Least share of the points of the object that lie above it."""


def support_plane(
    depths: Sequence[Float[np.ndarray, "H W"]],
    masks: Sequence[Bool[np.ndarray, "H W"]],
    intrinsics: Intrinsics,
    poses: Sequence[Float[np.ndarray, "4 4"]],
    seen: Float[np.ndarray, "P 3"],
    noise_m: float,
) -> Plane | None:
    """Return the plane that most points around the masks lie in, with its normal to the sensors; None: there is none.

    The object lies above it, no farther away than it is long.

    Args:
        depths: Depth pictures (H, W), metres; 0 or NaN: no depth.
        masks: Masks (H, W) of the object.
        intrinsics: Camera.
        poses: Poses (4, 4) of the camera in the frame of the object.
        seen: Points (P, 3) on the object, metres.
        noise_m: Standard deviation of the points along the lines of sight, metres.
    """
    views = zip(depths, masks, poses, strict=True)
    points = np.concatenate([points_of_depth(depth, _around(mask), intrinsics, pose) for depth, mask, pose in views])
    points = points[:: len(points) // MAX_POINTS + 1]
    reach = 1e-3 + 3.0 * noise_m
    if len(points) < 3 or not len(seen):
        return None
    corners = points[np.random.default_rng(0).integers(len(points), size=(TRIES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    away = np.abs(points @ normals.T - (corners[:, 0] * normals).sum(axis=1))
    inside = away[:, (away <= reach).sum(axis=0).argmax()] <= reach
    for _ in range(2):
        middle, normal = fitted_plane(points[inside])
        inside = np.abs((points - middle) @ normal) <= reach
        if inside.sum() < 3:
            return None
    towards = np.mean([pose[:3, 3] for pose in poses], axis=0) - middle
    normal = normal if towards @ normal > 0 else -normal
    height, length = (seen - middle) @ normal, np.linalg.norm(np.ptp(seen, axis=0))
    stands = (height > -reach).mean() >= ABOVE and np.quantile(height, 1.0 - ABOVE) <= length
    return (middle, normal) if stands and inside.mean() >= LEAST_SHARE else None


def _around(mask: Bool[np.ndarray, "H W"]) -> Bool[np.ndarray, "H W"]:
    """Return the pixels (H, W) of a strip around the bounding box of a mask, and of the box, outside the mask."""
    found = np.zeros_like(mask)
    if mask.any():
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        width = int(np.ceil(AROUND * max(np.ptp(rows), np.ptp(columns)))) + 2
        low = max(rows[0] - width, 0), max(columns[0] - width, 0)
        found[low[0] : rows[-1] + width + 1, low[1] : columns[-1] + width + 1] = True
    return found & ~mask
