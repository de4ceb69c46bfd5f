"""Folders of objects in the layouts of other programs: lookup of an object by name, and its convex pieces.

The folder of an object holds its convex pieces, decomposed by someone else, in one of these layouts:

    urdf/meshes/*             a mesh for each piece (DexGraspBench, BODex, Dexonomy); mesh/simplified.obj is the surface
    coacd/decomposed.obj      one file with a group of faces for each piece (DexGraspNet)
    *                         a mesh for each piece
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.errors import AssetError, MeshError
from grasp_refine.core.names import is_folder
from grasp_refine.geometry.mesh import SUFFIXES, FlatMeshError, load_groups, load_mesh, watertight
from grasp_refine.geometry.pieces import Piece, hull, joined_mesh

if TYPE_CHECKING:
    import trimesh

PIECES = Path("urdf", "meshes")
"""Convex pieces in the folder of an object of DexGraspBench and BODex."""

SURFACE = Path("mesh", "simplified.obj")
"""Surface in the same folder."""

GROUPS = Path("coacd", "decomposed.obj")
"""All convex pieces in the folder of an object of DexGraspNet."""

MAX_HULL_EXCESS, MAX_PIECE_EXCESS = 0.02, 0.25
"""Share of a convex piece's volume by which its hull may exceed it without a note, and at most where only meshes in a
folder say that they are convex pieces: beyond, they are rather the whole object, such as of YCB."""


def find_object(name: str, folder: str | Path) -> Path:
    """Return the mesh, or the folder of convex pieces, in `folder` for the object that a grasp file calls `name`.

    That is the one whose name is `name`, else the one whose name equals it, else the one whose name ends with it from
    the beginning of a word or number on, the last two ignoring case, `-` and `_`. The name of a mesh is its stem. Of a
    mesh and a folder of pieces with the same name the folder is used: the mesh would only be cut again.

    Raises:
        AssetError: the folder is missing, or none or several of its meshes and folders of pieces fit; lists them.
    """
    folder = Path(folder)
    if not is_folder(folder):
        raise AssetError(f"{folder}: no such folder of objects")
    called = {path: path.stem if _is_mesh(path) else path.name for path in sorted(folder.iterdir())}
    plain = _plain(name)
    for rule in (
        lambda own: own == name,
        lambda own: _plain(own) == plain,
        lambda own: plain and plain in map(_plain, _ends(own)),
    ):
        # The name is checked first: looking into each of a thousand folders for each of a thousand names takes minutes.
        fits = [path for path, own in called.items() if rule(own) and _is_object(path)]
        cut = {called[path] for path in fits if path.is_dir()}
        fits = [path for path in fits if path.is_dir() or called[path] not in cut]
        if len(fits) == 1:
            return fits[0]
        if fits:
            raise AssetError(f"object '{name}' could be any of {_listing(fits)} in {folder}")
    raise AssetError(f"no mesh of object '{name}' in {folder}; there are {_listing(filter(_is_object, called))}")


def given_pieces(folder: Path, scale: float) -> tuple[tuple[Piece, ...], tuple[str, ...]]:
    """The convex pieces in the folder of an object, times `scale`, in the order of their names; notes about them.

    Raises:
        MeshError: it has no meshes, all are flat, one is far from convex where no layout says that it is a piece, or
            one cannot be read: without it the object would have a gap.
    """
    pieces, notes, names = [], [], []
    most = np.inf if _meshes(folder / PIECES) or (folder / GROUPS).is_file() else MAX_PIECE_EXCESS
    for name, mesh in _solids(folder, scale):
        piece, note, excess = _piece(name, mesh)
        if excess > most:
            raise MeshError(
                f"{folder}: is no folder of convex pieces, the hull of {name} has {excess:.1%} more volume; give the "
                f"mesh of the object instead: {_listing(_meshes(folder))}"
            )
        names.append(name)
        pieces += [piece] if piece is not None else []
        notes += [note] if note is not None else []
    if not names:
        raise MeshError(
            f"{folder}: has no meshes of convex pieces, nor has its {PIECES.as_posix()} ({', '.join(SUFFIXES)}), nor "
            f"is there a {GROUPS.as_posix()}"
        )
    if not pieces:
        raise MeshError(f"{folder}: no usable convex piece, all are flat: {', '.join(names)}")
    return tuple(pieces), tuple(notes)


def surface(folder: Path, pieces: Sequence[Piece], scale: float) -> tuple[trimesh.Trimesh, tuple[str, ...]]:
    """Surface for display of an object with given pieces, in metres, and notes about it.

    Raises:
        MeshError: the surface in `folder` is unreadable, flat or empty.
    """
    path = folder / SURFACE
    others = _meshes(path.parent)
    if not path.is_file() and len(others) == 1:
        (path,) = others
    if not path.is_file():
        return joined_mesh(pieces), ()
    mesh = load_mesh(path, scale)
    try:
        return watertight(mesh, path.name)
    except MeshError:
        return mesh, (f"{path.name}: not watertight; it is only displayed, contacts are with the pieces",)


def _solids(folder: Path, scale: float) -> Iterator[tuple[str, trimesh.Trimesh | None]]:
    """Name and mesh of each convex piece in the folder of an object; None for a flat one."""
    if (folder / GROUPS).is_file() and not _meshes(folder / PIECES):
        yield from load_groups(folder / GROUPS, scale)
        return
    for path in _meshes(folder / PIECES) or _meshes(folder):
        try:
            yield path.name, load_mesh(path, scale)
        except FlatMeshError:
            yield path.name, None


def _piece(name: str, mesh: trimesh.Trimesh | None) -> tuple[Piece | None, str | None, float]:
    """The hull of a mesh, None if that is flat; a note for the user, if there is one; share of volume it exceeds by.

    The share is 0 where the volume of the mesh is not known.
    """
    try:
        piece = None if mesh is None else hull(mesh.vertices, name=name)
    except FlatMeshError:
        piece = None
    if mesh is None or piece is None:
        return None, f"{name}: flat; dropped", 0.0
    try:
        volume = watertight(mesh, name)[0].volume
    except MeshError:
        return piece, f"{name}: not watertight, so not known to be convex; its hull is used", 0.0
    excess = piece.mesh().volume / volume - 1
    if excess > MAX_HULL_EXCESS:
        return piece, f"{name}: not convex; its hull is used, which has {excess:.1%} more volume", excess
    return piece, None, excess


def _has_pieces(folder: Path) -> bool:
    return bool(_meshes(folder / PIECES) or (folder / GROUPS).is_file() or _meshes(folder))


def _meshes(folder: Path) -> list[Path]:
    return sorted(filter(_is_mesh, folder.iterdir())) if folder.is_dir() else []


def _is_mesh(path: Path) -> bool:
    return path.suffix.lower() in SUFFIXES


def _is_object(path: Path) -> bool:
    """Return True if `path` is a mesh or a folder of convex pieces."""
    return _has_pieces(path) if path.is_dir() else _is_mesh(path)


def _ends(name: str) -> list[str]:
    """Endings of a name from the beginning of a word or number on: an apple is no pineapple."""
    return [name[match.start() :] for match in re.finditer(r"[0-9]+|[^\W\d_]+", name)]


def _plain(name: str) -> str:
    return name.replace("-", "").replace("_", "").lower()


def _listing(paths: Iterable[Path]) -> str:
    names = [f"{path.name}/" if path.is_dir() else path.name for path in paths]
    return ", ".join(names) or f"no meshes ({', '.join(SUFFIXES)})"
