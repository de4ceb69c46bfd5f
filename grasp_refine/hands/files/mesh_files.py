"""Mesh files that a URDF names: finding and reading them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

import numpy as np

from grasp_refine.core.errors import HandError, MeshError
from grasp_refine.core.lfs_pointer import refuse_lfs_pointer
from grasp_refine.core.names import is_file
from grasp_refine.geometry.mesh import check_mesh, check_unpacked, load_mesh, quietly

if TYPE_CHECKING:
    import trimesh


def read_mesh(path: Path) -> trimesh.Trimesh:
    """The mesh of a file, each triangle once, in the file's own unit or, for Collada, in metres.

    Raises:
        MeshError: the file is of another format, broken, empty or flat.
    """
    mesh = _read_collada(path) if path.suffix.lower() == ".dae" else load_mesh(path)
    # A face and its reverse count once: with both, no faces would form a connected body.
    mesh.update_faces(mesh.unique_faces())
    return mesh


def _read_collada(path: Path) -> trimesh.Trimesh:
    import trimesh

    refuse_lfs_pointer(path, "mesh", MeshError)
    check_unpacked(path)
    try:
        with quietly():
            scene = trimesh.load_scene(path, process=False)
            loaded = scene.to_mesh()
        # As in ROS: the file's unit counts, its "up axis" does not.
        unit = trimesh.units.unit_conversion(scene.units or "meters", "meters")
    # On a broken file the reader raises exceptions of any type.
    except Exception as error:
        raise MeshError(f"{path}: cannot be read as a mesh ({type(error).__name__}: {error})") from error
    # Equal vertices are merged, so that connected faces form one body.
    corners, faces = np.unique(np.asarray(loaded.triangles).reshape(-1, 3) * unit, axis=0, return_inverse=True)
    mesh = trimesh.Trimesh(corners, faces.reshape(-1, 3), process=False)
    check_mesh(mesh, str(path))
    return mesh


def resolve_mesh(filename: str, urdf: Path) -> Path:
    """Path of the file that a mesh's `filename` in the URDF file `urdf` refers to; nothing is fetched from a network.

    A plain path is relative to the URDF's folder, else to the folder above it, as in packages that keep URDFs in a
    folder of their own beside `meshes`. `package://NAME/REST` is searched as NAME/REST and as REST in
    the URDF's folder and in every folder above it, nearest first. `file://PATH` is PATH.

    Raises:
        HandError: there is no such file (lists the tried paths), or the address is of another kind.
    """
    scheme, _, rest = filename.rpartition("://")
    folder = urdf.absolute().parent
    if scheme == "package":
        name, _, inside = rest.partition("/")
        tried = [place / path for place in (folder, *folder.parents) for path in (rest, inside)]
        where = f"{rest} and {inside} in {folder} and the folders above it (the package is '{name}')"
    elif scheme in ("", "file"):
        inside = unquote(rest) if scheme else rest
        tried = list(dict.fromkeys((folder / inside, folder.parent / inside)))
        where = " and ".join(map(str, tried))
    else:
        raise HandError(f"mesh '{filename}': only paths, file:// and package:// are read")
    found = next((path for path in tried if is_file(path)), None)
    if found is None:
        raise HandError(f"mesh '{filename}' not found: tried {where}")
    return found
