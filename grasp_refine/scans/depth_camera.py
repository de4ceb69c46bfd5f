"""Depth cameras: pictures of meshes, with the noise, the holes and the mask errors of a common one, and back to points.

Camera frames are those of OpenCV: x to the right, y down, z forward; the centre of the first pixel is (0, 0).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.errors import MeshError
from grasp_refine.core.se3 import inverse, transform, transform_points
from grasp_refine.geometry.mesh import MAX_DIAGONAL
from grasp_refine.geometry.z_buffer import rasterize
from grasp_refine.scans.cleaning import scan_of_points
from grasp_refine.scans.scan import Scan

if TYPE_CHECKING:
    import trimesh

BASELINE_M, SUBPIXEL, DISPARITY_STEP = 0.05, 0.08, 1 / 32
"""Distance of the two imagers of a RealSense D435, standard deviation of its disparity and its step, pixels.

Sources: Intel, "Best-Known-Methods for Tuning Intel RealSense D400 Depth Cameras for Best Performance" (the depth is
off by z^2 s / (f b)), and "Subpixel Linearity Improvement for Intel RealSense Depth Camera D400 Series" (the step).
"""

WINDOW_PX = 1.5
"""Standard deviation of the window that disparities are matched in, within which their errors are alike; assumed."""

LATERAL_PX, LATERAL_SLOPE_PX, GRAZING_DEG = 0.8, 0.035, 80.0
"""Lateral noise at edges, 0.8 + 0.035 t / (pi / 2 - t) pixels for surfaces turned by t away from the camera, and the
turn above which there is no depth.

Source: Nguyen, Izadi and Lovell, "Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking", 2012.
"""

EDGE_STEP, EDGE_HOLES, FLYING, FLYING_M = 12.0, 0.3, 0.1, 0.03
"""Step in depth between pixels that is an edge, in widths of a pixel; shares of pixels at edges without depth and with
one between near and far, and how far that is behind the near one where nothing is behind; assumed."""

MASK_PX, MASK_BLOB_PX = 1.5, 8.0
"""Standard deviation by which the border of a mask is off, and the length along the border of such errors; assumed."""

ELEVATIONS_DEG = (20.0, 60.0)
"""Elevations of cameras above the horizon of an object."""

DISTANCE_M = 0.5
"""Distance of cameras from the middle of an object, where the object fits into the picture."""


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera without distortion."""

    fx: float
    """Focal length to the right, pixels."""
    fy: float
    """Focal length downwards, pixels."""
    cx: float
    """Column of the optical axis, pixels."""
    cy: float
    """Row of the optical axis, pixels."""
    width: int
    """Width of the pictures, pixels."""
    height: int
    """Height of the pictures, pixels."""


D435 = Intrinsics(424.0, 424.0, 423.5, 239.5, 848, 480)
"""Intel RealSense D435 at 848 x 480: 90 degrees across, the resolution that Intel recommends."""


def views_around(
    mesh: trimesh.Trimesh, count: int, seed: int, intrinsics: Intrinsics = D435
) -> Float[np.ndarray, "count 4 4"]:
    """Return poses (count, 4, 4) of cameras around a mesh, in its frame, that look at its middle; z is up.

    They are spread evenly around the vertical, from a random one on, at random `ELEVATIONS_DEG`.
    """
    random = np.random.default_rng(seed)
    around = random.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(count) / count
    above = np.radians(random.uniform(*ELEVATIONS_DEG, count))
    low, high = mesh.bounds
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    narrow = min(intrinsics.width / intrinsics.fx, intrinsics.height / intrinsics.fy) / 2
    # The sphere around the object fits into the picture, with a tenth to spare.
    distance = max(DISTANCE_M, 1.1 * radius * float(np.hypot(1.0, narrow)) / narrow)
    out = np.stack([np.cos(around) * np.cos(above), np.sin(around) * np.cos(above), np.sin(above)], axis=-1)
    right = np.stack([-np.sin(around), np.cos(around), np.zeros(count)], axis=-1)
    return transform(np.stack([right, np.cross(-out, right), -out], axis=-1), middle + distance * out)


def depth_of(
    mesh: trimesh.Trimesh, pose: Float[np.ndarray, "4 4"], intrinsics: Intrinsics = D435
) -> Float[np.ndarray, "H W"]:
    """Return the depth (H, W) of a mesh along the optical axis of a camera, metres; 0: nothing is there.

    Args:
        mesh: Mesh, metres.
        pose: Pose (4, 4) of the camera in the frame of the mesh.
        intrinsics: Camera.

    Raises:
        MeshError: the mesh reaches behind the camera.
    """
    points = transform_points(inverse(pose), np.asarray(mesh.vertices))
    if points[:, 2].min() <= 0:
        raise MeshError("the mesh reaches behind the camera; move the camera away")
    flat = np.stack(
        [
            intrinsics.fx * points[:, 0] / points[:, 2] + intrinsics.cx + 0.5,
            intrinsics.fy * points[:, 1] / points[:, 2] + intrinsics.cy + 0.5,
            -1.0 / points[:, 2],
        ],
        axis=-1,
    )
    nearest, least = rasterize(flat[np.asarray(mesh.faces)], (intrinsics.height, intrinsics.width))
    return np.where(nearest < 0, 0.0, -1.0 / least)


def depth_noise(depth: Any, intrinsics: Intrinsics = D435) -> Any:
    """Return the standard deviation of depths of a RealSense D435, metres: numbers or arrays."""
    return depth**2 * (SUBPIXEL / (intrinsics.fx * BASELINE_M))


def with_noise(depth: Float[np.ndarray, "H W"], seed: int, intrinsics: Intrinsics = D435) -> Float[np.ndarray, "H W"]:
    """Return a depth picture (H, W) as a RealSense D435 would have taken it, metres; 0: no depth.

    Edges move by the lateral noise, and have holes and points between near and far; surfaces seen at a grazing angle
    are missing; disparities have noise that is alike in the window of the matching, and steps.

    Args:
        depth: Exact depth, metres; 0: nothing is there.
        seed: Seed of the noise.
        intrinsics: Camera.
    """
    from scipy import ndimage

    random = np.random.default_rng(seed)
    shape = depth.shape
    turn = _turn(depth, intrinsics)
    sideways = LATERAL_PX + LATERAL_SLOPE_PX * turn / (np.pi / 2 - turn)
    row, column = (
        np.clip(np.round(at + sideways * random.standard_normal(shape)).astype(int), 0, size - 1)
        for at, size in zip(np.indices(shape), shape, strict=True)
    )
    moved = depth[row, column]
    edge = np.abs(moved - depth) > EDGE_STEP * np.maximum(moved, depth) / intrinsics.fx
    border = ndimage.binary_dilation(edge)
    behind = np.maximum(moved, depth)
    near = np.where(np.minimum(moved, depth) > 0, np.minimum(moved, depth), behind)
    between = near + random.random(shape) * np.where(behind > near, behind - near, FLYING_M)
    lot = random.random(shape)
    found = np.where(edge, np.where(lot > 1 - FLYING, between, moved), depth)
    found[(border & (lot < EDGE_HOLES)) | (turn > np.radians(GRAZING_DEG))] = 0.0

    error = ndimage.gaussian_filter(random.standard_normal(shape), WINDOW_PX)
    scale = intrinsics.fx * BASELINE_M
    seen = found > 0
    disparity = scale / np.where(seen, found, 1.0) + SUBPIXEL * error * (2 * np.sqrt(np.pi) * WINDOW_PX)
    disparity = np.round(disparity / DISPARITY_STEP) * DISPARITY_STEP
    return np.where(seen & (disparity > 0), scale / np.maximum(disparity, DISPARITY_STEP), 0.0)


def with_mask_errors(mask: Bool[np.ndarray, "H W"], seed: int) -> Bool[np.ndarray, "H W"]:
    """Return a mask (H, W) whose border is off by `MASK_PX`, in blobs as those of a segmentation."""
    from scipy import ndimage

    error = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(mask.shape), MASK_BLOB_PX)
    error *= 2 * np.sqrt(np.pi) * MASK_BLOB_PX * MASK_PX
    inside, outside = ndimage.distance_transform_edt(mask), ndimage.distance_transform_edt(~mask)
    return np.where(mask, inside - 0.5, 0.5 - outside) + error > 0


def points_of_depth(
    depth: Float[np.ndarray, "H W"],
    mask: Bool[np.ndarray, "H W"] | None,
    intrinsics: Intrinsics,
    pose: Float[np.ndarray, "4 4"],
) -> Float[np.ndarray, "P 3"]:
    """Return the points (P, 3) of the pixels within the mask that have a depth, in the frame of the pose, metres."""
    seen = (depth > 0) & (depth < MAX_DIAGONAL)
    row, column = np.nonzero(seen if mask is None else seen & mask)
    z = depth[row, column]
    x, y = (column - intrinsics.cx) * z / intrinsics.fx, (row - intrinsics.cy) * z / intrinsics.fy
    return transform_points(pose, np.stack([x, y, z], axis=-1))


def scan_of_depth(
    depths: Sequence[Float[np.ndarray, "H W"]],
    masks: Sequence[Bool[np.ndarray, "H W"]] | None,
    intrinsics: Intrinsics,
    poses: Sequence[Float[np.ndarray, "4 4"]],
    name: str = "scan",
) -> Scan:
    """Return the scan of depth pictures of one object.

    Args:
        depths: Depth pictures (H, W), metres; 0 or NaN: no depth.
        masks: Masks (H, W) of the object, one for each picture; None: all that has a depth is the object.
        intrinsics: Camera.
        poses: Poses (4, 4) of the camera in the frame of the object.
        name: Name of the object, for messages.

    Raises:
        MeshError: there are too few points, they lie in a plane and there is no mask, or they are several objects.
    """
    points, view, noise = seen_in_depth(depths, masks, intrinsics, poses)
    origins = np.array([pose[:3, 3] for pose in poses]).reshape(-1, 3)
    return scan_of_points(points, None, origins, view, name, noise_m=noise, masked=masks is not None)[0]


def seen_in_depth(
    depths: Sequence[Float[np.ndarray, "H W"]],
    masks: Sequence[Bool[np.ndarray, "H W"]] | None,
    intrinsics: Intrinsics,
    poses: Sequence[Float[np.ndarray, "4 4"]],
) -> tuple[Float[np.ndarray, "P 3"], Int[np.ndarray, " P"], float]:
    """Return the points (P, 3) of depth pictures as of `scan_of_depth`, the picture (P,) of each, and their noise."""
    views = [
        points_of_depth(depth, None if masks is None else masks[at], intrinsics, pose)
        for at, (depth, pose) in enumerate(zip(depths, poses, strict=True))
    ]
    distances = [(points - pose[:3, 3]) @ pose[:3, 2] for points, pose in zip(views, poses, strict=True)]
    points, distance = np.concatenate([np.zeros((0, 3)), *views]), np.concatenate([np.zeros(0), *distances])
    # A picture that was made smaller has no more noise for that.
    sharp = intrinsics if intrinsics.fx > D435.fx else D435
    noise = float(depth_noise(np.median(distance), sharp)) if len(points) else 0.0
    return points, np.repeat(np.arange(len(views)), [len(part) for part in views]), noise


def _turn(depth: Float[np.ndarray, "H W"], intrinsics: Intrinsics) -> Float[np.ndarray, "H W"]:
    """Return the angle (H, W) between the surface's normal and the line of sight, radians; at edges of the nearer side.

    With the depth z(u, v), the normal of the surface is along (fx z_u, fy z_v, -z - (u - cx) z_u - (v - cy) z_v).
    """
    row, column = np.indices(depth.shape)
    u, v = column - intrinsics.cx, row - intrinsics.cy
    most = EDGE_STEP * depth / intrinsics.fx
    slopes = []
    for axis in (1, 0):
        step = np.diff(depth, axis=axis)
        before, after = (np.insert(step, at, np.nan, axis=axis) for at in (0, step.shape[axis]))
        before, after = (np.where(np.abs(side) > most, np.nan, side) for side in (before, after))
        slope = np.where(np.isnan(before), after, np.where(np.isnan(after), before, (before + after) / 2))
        slopes.append(np.where(np.isnan(slope), most, slope))
    z_u, z_v = slopes
    normal = np.stack([intrinsics.fx * z_u, intrinsics.fy * z_v, -depth - u * z_u - v * z_v], axis=-1)
    sight = np.stack([u / intrinsics.fx, v / intrinsics.fy, np.ones(depth.shape)], axis=-1)
    length = np.linalg.norm(normal, axis=-1) * np.linalg.norm(sight, axis=-1)
    cosine = np.abs((normal * sight).sum(axis=-1)) / np.where(depth > 0, length, 1.0)
    return np.where(depth > 0, np.arccos(np.clip(cosine, 0.0, 1.0)), 0.0)
