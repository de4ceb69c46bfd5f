"""Scans from files and arrays: point clouds, open meshes, depth pictures of one view or several.

Open3D would read PLY and PCD as well, but its wheel has 400 MB; what it takes here are a few lines of NumPy each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from grasp_refine.core.arguments import as_numbers
from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspFileError, GraspRefineError, MeshError
from grasp_refine.core.lfs_pointer import refuse_lfs_pointer
from grasp_refine.core.names import is_file
from grasp_refine.core.npz_files import load_npz
from grasp_refine.core.se3 import transform_points
from grasp_refine.geometry.mesh import MAX_DIAGONAL
from grasp_refine.geometry.units import UNITS, Unit, check_size
from grasp_refine.scans.camera_files import (
    PICTURES,
    as_intrinsics,
    as_mask,
    as_poses,
    as_positions,
    depth_in_metres,
    read_array,
    read_picture,
)
from grasp_refine.scans.cleaning import MAX_POINTS, scan_of_points
from grasp_refine.scans.cloud import MAX_READ_POINTS, Cloud, check_point_count, every, text_columns
from grasp_refine.scans.depth_camera import Intrinsics, seen_in_depth
from grasp_refine.scans.pcd import read_pcd
from grasp_refine.scans.ply import is_cloud, read_ply
from grasp_refine.scans.scan import Scan
from grasp_refine.scans.support import support_plane

if TYPE_CHECKING:
    import trimesh
    from numpy.typing import ArrayLike

CLOUDS = (".pcd", ".xyz", ".npz", ".npy")
"""Suffixes of files that hold points or depth, and never a mesh; a PLY file may hold either."""

SCAN_SUFFIXES = (*CLOUDS, *PICTURES)
"""Suffixes of files that are scans."""

MESH_SEED = 0
"""Seed of the points on an open mesh."""

UNIT_LENGTH = (0.9, 1.1)
"""Lengths of normals in a text file, beyond which the three numbers behind a point are something else."""


@dataclass(frozen=True, eq=False)
class Sensors:
    """From where, and with which camera, an object was seen; each None: unknown, or in the file."""

    seen_from: Any = None
    """Optical centres of the sensors in the object's frame, metres: as of `as_positions`."""
    camera: Any = None
    """Poses of the camera in the object's frame: as of `as_poses`; points are then in the camera's frame."""
    intrinsics: Any = None
    """Camera of depth pictures: as of `as_intrinsics`."""
    mask: Any = None
    """Mask of the object in depth pictures: a picture, or arrays."""

    @property
    def known(self) -> bool:
        """Whether anything is given."""
        return any(value is not None for value in (self.seen_from, self.camera, self.intrinsics, self.mask))


def is_scan(path: Path) -> bool:
    """Return whether a file holds points without faces, or depth."""
    suffix = path.suffix.lower()
    return suffix in SCAN_SUFFIXES or (suffix == ".ply" and is_file(path) and is_cloud(path))


def read_scan(
    path: Path, sensors: Sensors, *, scale: float = 1.0, unit: Unit | None = None
) -> tuple[Scan, tuple[str, ...]]:
    """Return the scan in a file that `is_scan`, and notes for the user.

    Args:
        path: PLY, PCD, XYZ, NPY or NPZ of points (`points`, and `normals`, `origins`, `view` where they are known), or
            depth: PNG, TIFF, NPY, or NPZ of `depth`, and `mask`, `intrinsics`, `camera`, of one view or several.
        sensors: The sensors, which precede those of the file.
        scale: Factor that takes the points, or the depth, to their unit.
        unit: Of the points, as in `load_object`.

    Raises:
        MeshError: the file is missing, damaged or too large, or its points make no scan.
        GraspRefineError: the sensors cannot be read.
    """
    if not is_file(path):
        raise MeshError(f"{path}: no such file")
    refuse_lfs_pointer(path, "scan", MeshError)
    suffix = path.suffix.lower()
    values: dict[str, np.ndarray] = {}
    if suffix == ".npz":
        try:
            values = dict(load_npz(path).entries)
        except GraspFileError as error:
            raise MeshError(str(error).replace("grasp file", "scan")) from None
    elif suffix == ".npy":
        array = read_array(path)
        values = {"points" if array.ndim == 2 and array.shape[1] == 3 else "depth": array}
    elif suffix in PICTURES:
        values = {"depth": read_picture(path)}
    if "depth" in values:
        return _scan_of_pictures(values, sensors, scale, unit, str(path))
    if sensors.intrinsics is not None or sensors.mask is not None:
        raise GraspRefineError(f"{path}: holds points; intrinsics and a mask are for depth pictures")
    read: Callable[[Path], Cloud] = {".ply": read_ply, ".pcd": read_pcd, ".xyz": _read_xyz}.get(
        suffix, lambda path: _cloud_of_arrays(values, str(path))
    )
    return scan_of_cloud(read(path), sensors, scale=scale, unit=unit, name=str(path))


def scan_of_cloud(
    cloud: Cloud, sensors: Sensors, *, scale: float = 1.0, unit: Unit | None = None, name: str
) -> tuple[Scan, tuple[str, ...]]:
    """Return the scan of a cloud, and notes for the user; see `read_scan`."""
    factor = scale * UNITS[unit or "m"]
    with np.errstate(over="ignore", invalid="ignore"):
        points, normals = cloud.points * factor, cloud.normals
    _check_size(points, UNITS[unit or "m"], unit, name)
    origins = np.zeros((0, 3)) if cloud.origins is None else np.asarray(cloud.origins, dtype=np.float64) * factor
    view = cloud.view
    if sensors.camera is not None:
        if sensors.seen_from is not None:
            raise GraspRefineError(f"{name}: `camera` and `seen_from` exclude each other: the pose has the position")
        (pose, *others) = as_poses(sensors.camera)
        if others:
            raise GraspRefineError(f"{name}: points of one camera need one pose, `camera` has {1 + len(others)}")
        points, origins, view = transform_points(pose, points), pose[None, :3, 3], None
        normals = None if normals is None else normals @ pose[:3, :3].T
    elif sensors.seen_from is not None:
        origins, view = as_positions(sensors.seen_from), None
    scan, notes = scan_of_points(points, normals, origins, view, name)
    if cloud.count > len(points):
        notes = (f"of its {cloud.count} points every {every(cloud.count)}th is read", *notes)
    return scan, notes


def scan_of_mesh(mesh: trimesh.Trimesh, sensors: Sensors, name: str) -> tuple[Scan, tuple[str, ...]]:
    """Return the scan of an open mesh in metres: points spread evenly over its surface."""
    import trimesh

    points, face = trimesh.sample.sample_surface(mesh, MAX_POINTS, seed=MESH_SEED)
    cloud = Cloud(np.asarray(points), np.asarray(mesh.face_normals)[face])
    scan, notes = scan_of_cloud(cloud, sensors, unit="m", name=name)
    # Points on triangles have no noise of their own; what the mesh was made of is not known.
    return replace(scan, noise_m=0.0), notes


def _scan_of_pictures(
    values: dict[str, np.ndarray], sensors: Sensors, scale: float, unit: Unit | None, name: str
) -> tuple[Scan, tuple[str, ...]]:
    """Return the scan of depth pictures and what is beside them in a file."""
    depths = depth_in_metres(values["depth"], name)
    if values["depth"].dtype.kind != "f" and unit not in (None, "m"):
        raise MeshError(
            f"{name}: integers are millimetres already: leave out `unit='{unit}'`; of other steps give `scale`, 0.25 "
            "where one is a quarter of a millimetre"
        )
    shape = depths.shape
    with np.errstate(over="ignore", invalid="ignore"):
        depths = depths.reshape(-1, *depths.shape[-2:]) * scale * UNITS[unit or "m"]
    if sensors.seen_from is not None:
        raise GraspRefineError(f"{name}: a depth picture needs the pose of its camera, `camera`, not `seen_from`")
    intrinsics, mask, camera = (
        values.get(key) if value is None else value
        for key, value in (
            ("intrinsics", sensors.intrinsics),
            ("mask", sensors.mask),
            ("camera", sensors.camera),
        )
    )
    if intrinsics is None:
        raise GraspRefineError(
            f"{name}: a depth picture needs the `intrinsics` of its camera: fx, fy, cx, cy in pixels"
        )
    fx, fy, cx, cy = as_intrinsics(intrinsics)
    lens = Intrinsics(fx, fy, cx, cy, depths.shape[2], depths.shape[1])
    masks = None if mask is None else as_mask(mask, shape, name).reshape(depths.shape)
    poses = np.eye(4)[None] if camera is None else as_poses(camera)
    if len(poses) != len(depths):
        raise GraspRefineError(f"{name}: has {len(depths)} pictures, `camera` has {len(poses)} poses")
    points, view, noise = seen_in_depth(list(depths), None if masks is None else list(masks), lens, list(poses))
    if not len(points):
        raise MeshError(f"{name}: empty: no pixel{' of the mask' if masks is not None else ''} has a depth")
    check_point_count(len(points), name)
    _check_size(points, UNITS[unit or "m"], unit, name)
    around = None if masks is None else support_plane(list(depths), list(masks), lens, list(poses), points, noise)
    return scan_of_points(
        points, None, poses[:, :3, 3], view, name, noise_m=noise, masked=masks is not None, table=around
    )


def _check_size(points: Float[np.ndarray, "P 3"], factor: float, unit: Unit | None, name: str) -> None:
    """Refuse points whose unit is in doubt, see `check_size`; a few stray ones do not count."""
    finite = points[(np.abs(points) < MAX_DIAGONAL).all(axis=1)]
    if len(finite):
        low, high = np.percentile(finite[:: every(10 * len(finite))], [1, 99], axis=0)
        if (high > low).any():
            check_size((high - low) / factor, unit, name)


def _cloud_of_arrays(values: dict[str, np.ndarray], name: str) -> Cloud:
    """Return the cloud of the arrays of a file.

    Raises:
        MeshError: they are of other types or shapes.
    """
    if "points" not in values:
        raise MeshError(f"{name}: has no points and no depth, but {', '.join(values) or 'nothing'}")
    return cloud_of_arrays(values["points"], values.get("normals"), name, values.get("origins"), values.get("view"))


def cloud_of_arrays(
    points: ArrayLike,
    normals: ArrayLike | None,
    name: str,
    origins: ArrayLike | None = None,
    view: ArrayLike | None = None,
) -> Cloud:
    """Return the cloud of arrays.

    Raises:
        MeshError: they are of other types or shapes.
    """
    try:
        xyz = as_numbers(f"{name}: points", points, "P", 3)
        directions = None if normals is None else as_numbers(f"{name}: normals", normals, len(xyz), 3)
        centres = None if origins is None else as_numbers(f"{name}: origins", origins, "V", 3)
        seen = None if view is None else as_numbers(f"{name}: view", view, len(xyz))
    except GraspRefineError as error:
        raise MeshError(str(error)) from None
    check_point_count(len(xyz), name)
    if seen is not None:
        if centres is None or not ((seen % 1 == 0) & (seen >= 0) & (seen < len(centres))).all():
            raise MeshError(f"{name}: view must hold indices of its {0 if centres is None else len(centres)} origins")
        seen = seen.astype(np.int64)
    step = every(len(xyz)) if len(xyz) else 1
    return Cloud(
        xyz[::step],
        None if directions is None else directions[::step],
        centres,
        None if seen is None else seen[::step],
        len(xyz),
    )


def _read_xyz(path: Path) -> Cloud:
    """Return the points of a text file: x y z, and normals where three unit numbers follow."""
    with path.open("r", encoding="utf-8", errors="replace") as file:
        first = next((line for line in file if line.split("#")[0].strip()), "")
        file.seek(0)
        commas = "," in first
        words = len(first.split("#")[0].replace(",", " ").split())
        lines = (line.replace(",", " ") for line in file) if commas else file
        values = text_columns(lines, MAX_READ_POINTS + 1, range(6 if words >= 6 else 3), path)
    check_point_count(len(values), path)
    points, normals = values[:, :3], values[:, 3:]
    with np.errstate(over="ignore"):
        length = np.linalg.norm(normals, axis=1)
    low, high = UNIT_LENGTH
    unit = bool(len(values)) and words >= 6 and bool(((length > low) & (length < high)).mean() > 0.5)
    step = every(len(values)) if len(values) else 1
    return Cloud(points[::step], normals[::step] if unit else None, count=len(values))
