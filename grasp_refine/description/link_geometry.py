"""The collision geometry of a link as convex pieces: primitives as they are, meshes as their convex hulls."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

import numpy as np
from jaxtyping import Float

from grasp_refine.errors import HandError, MeshError
from grasp_refine.geometry.mesh import load_mesh
from grasp_refine.geometry.pieces import Piece, box, cylinder, hull, sphere

if TYPE_CHECKING:
    import yourdfpy


def link_pieces(link: yourdfpy.Link, urdf: Path, hulls: dict[Path, Piece]) -> tuple[Piece, ...]:
    """The convex pieces of `link` in its frame, one per <collision> element; a repeated element counts once.

    `hulls` maps mesh files to their hulls, unscaled; it is filled here, so that a file that several links
    share is read once.

    Raises:
        HandError: a mesh file is missing or cannot be used, or a piece has no thickness; names the link.
    """
    pieces: list[Piece] = []
    for collision in link.collisions:
        try:
            piece = _piece(collision.geometry, urdf, hulls)
            if collision.origin is not None:
                piece = piece.transformed(collision.origin)
        except (HandError, MeshError) as error:
            raise HandError(f"{urdf}: link '{link.name}': {error}") from None
        # Two pieces in one place would each hide the other's surface.
        if not any(np.array_equal(piece.vertices, p.vertices) and piece.radius == p.radius for p in pieces):
            pieces.append(piece)
    return tuple(pieces)


def _piece(geometry: yourdfpy.Geometry, urdf: Path, hulls: dict[Path, Piece]) -> Piece:
    if geometry.box is not None:
        return box(geometry.box.size)
    if geometry.cylinder is not None:
        return cylinder(geometry.cylinder.radius, geometry.cylinder.length)
    if geometry.sphere is not None:
        return sphere(geometry.sphere.radius)
    path = resolve_mesh(geometry.mesh.filename, urdf)
    if path not in hulls:
        hulls[path] = hull(_mesh_points(path), name=path.name)
    if geometry.mesh.scale is None:
        return hulls[path]
    # The hull is taken again: a mirrored or unevenly scaled one has other face orientations.
    return hull(hulls[path].vertices * geometry.mesh.scale, name=f"{path.name} x {geometry.mesh.scale}")


def _mesh_points(path: Path) -> Float[np.ndarray, "N 3"]:
    if path.suffix.lower() != ".dae":
        return load_mesh(path).vertices
    import trimesh

    try:
        scene = trimesh.load_scene(path, process=False)
        # As in ROS: the file's unit counts, its "up axis" does not.
        return scene.to_mesh().vertices * trimesh.units.unit_conversion(scene.units or "meters", "meters")
    # The reader raises whatever a broken file makes it trip over.
    except Exception as error:
        raise MeshError(f"{path}: cannot be read as a mesh ({type(error).__name__}: {error})") from error


def resolve_mesh(filename: str, urdf: Path) -> Path:
    """The file that a mesh's `filename` in the URDF file `urdf` means; nothing is fetched from a network.

    A plain path is relative to the URDF. `package://NAME/REST` is looked for as NAME/REST and as REST in
    the URDF's folder and in every folder above it, nearest first. `file://PATH` is PATH.

    Raises:
        HandError: there is no such file (lists what was tried), or the address is of another kind.
    """
    scheme, _, rest = filename.rpartition("://")
    folder = urdf.absolute().parent
    if scheme == "package":
        name, _, inside = rest.partition("/")
        tried = [place / path for place in (folder, *folder.parents) for path in (rest, inside)]
        where = f"{rest} and {inside} in {folder} and the folders above it (the package is '{name}')"
    elif scheme in ("", "file"):
        tried = [folder / (unquote(rest) if scheme else rest)]
        where = str(tried[0])
    else:
        raise HandError(f"mesh '{filename}': only paths, file:// and package:// are read")
    found = next((path for path in tried if path.is_file()), None)
    if found is None:
        raise HandError(f"mesh '{filename}' not found: tried {where}")
    return found
