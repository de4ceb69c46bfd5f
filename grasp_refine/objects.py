"""Objects: a mesh in metres and the convex pieces that stand for it in collision queries.

A folder can hold the pieces of an object, cut by someone else. Its meshes are the pieces; or, as in the object sets of
DexGraspBench and BODex, those of its folder `urdf/meshes` are, and `mesh/simplified.obj` is the surface.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from grasp_refine.errors import AssetError, MeshError
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.cache import default_cache
from grasp_refine.geometry.mesh import SUFFIXES, FlatMeshError, is_convex, load_mesh, watertight
from grasp_refine.geometry.pieces import Decomposition, Piece, convex_pieces, hull
from grasp_refine.geometry.shapes import EMBEDDED, primitive, primitive_pieces

if TYPE_CHECKING:
    import trimesh

PRIMITIVE_FORMS = "box:x,y,z, sphere:r, cylinder:r,h (metres)"

PIECES = Path("urdf", "meshes")
"""Where DexGraspBench and BODex keep the convex pieces in the folder of an object."""

SURFACE = Path("mesh", "simplified.obj")
"""Where they keep its surface."""

MOST_EXCESS = 0.02
"""Share of its own volume by which the hull of a convex piece may exceed it, before that is noted."""


@dataclass(frozen=True, eq=False)
class Object:
    """Something to grasp, at rest in its own frame."""

    name: str
    """Embedded name, primitive, stem of the mesh file, or name of the folder."""
    mesh: trimesh.Trimesh
    """Surface, metres; what is shown. Watertight, unless a note says that the surface beside given pieces is not."""
    body: Body
    """Convex pieces and surface candidates; what is touched."""
    convex: bool
    """Whether it is one convex piece."""
    notes: tuple[str, ...]
    """What was repaired in the mesh, or is wrong with given pieces, for the user."""


def load_object(
    source: str | Path,
    *,
    scale: float = 1.0,
    decomposition: Decomposition | None = None,
    candidates: int = 1024,
    seed: int = 0,
    cache: Path | Literal["user"] | None = "user",
    progress: Callable[[str], None] | None = None,
) -> Object:
    """Return the object that `source` names: an embedded one, a primitive, a mesh file, or a folder of pieces.

    The hulls of the meshes in a folder are the convex pieces, in the order of their names; nothing is decomposed. What
    is shown is the folder's surface if it has one (`mesh/simplified.obj`, or the only mesh in `mesh`), else all pieces.

    Args:
        source: name in EMBEDDED, "box:x,y,z", "sphere:r", "cylinder:r,h", or a path.
        scale: factor that takes the mesh, or the pieces, to metres.
        decomposition: how a concave mesh is cut into convex pieces; the defaults when None.
        candidates: number of points on the surface.
        seed: of the surface points.
        cache: folder of decompositions made before; "user" is the user's cache folder, None keeps none.
        progress: gets one line when a decomposition starts and one when it is done.

    Raises:
        AssetError: no such name.
        MeshError: the mesh is missing, unreadable, open, flat or empty, a folder has no usable piece or one that
            cannot be read, or the scale is not positive.
    """
    text = str(source)
    if not (np.isfinite(scale) and scale > 0):
        raise MeshError(f"{text}: the scale must be positive and finite, got {scale:g}")
    # An empty path would be the present folder.
    if text and (text not in EMBEDDED or isinstance(source, Path)) and Path(text).is_dir():
        return _from_folder(Path(text), scale, candidates, seed)
    if Path(text).suffix.lower() in SUFFIXES or isinstance(source, Path):
        name, mesh = Path(text).stem, load_mesh(text, scale)
    elif text in EMBEDDED:
        name, mesh = text, EMBEDDED[text]().apply_scale(scale)
    elif ":" in text:
        pieces = [Piece(p.vertices * scale, p.faces, p.radius * scale) for p in primitive_pieces(text)]
        body = build_body(text, pieces, candidates=candidates, seed=seed)
        return Object(text, primitive(text).apply_scale(scale), body, convex=True, notes=())
    elif "/" in text or Path(text).suffix:
        name, mesh = Path(text).stem, load_mesh(text, scale)
    else:
        raise AssetError(
            f"no object '{text}': embedded ones are {', '.join(EMBEDDED)}; "
            f"primitives are {PRIMITIVE_FORMS}; "
            f"or give a mesh file ({', '.join(SUFFIXES)}), or a folder of meshes that are its convex pieces"
        )
    mesh, notes = watertight(mesh, name)
    folder = default_cache() if cache == "user" else cache
    pieces = convex_pieces(mesh, decomposition, cache=folder, progress=progress, name=name)
    body = build_body(name, pieces, candidates=candidates, seed=seed)
    return Object(name, mesh, body, convex=is_convex(mesh), notes=notes)


def find_object(name: str, folder: str | Path) -> Path:
    """Return the mesh, or the folder of convex pieces, in `folder` that `name` means, as a grasp file may call it.

    That is the one whose name is `name`, else the one whose name is it, else the one whose name ends with it, the last
    two whatever the case and without `-` and `_`. The name of a mesh is its stem. Of a mesh and a folder of pieces with
    the same name the folder is meant: the mesh would only be cut into pieces again.

    Raises:
        AssetError: the folder is missing, or none or several of its meshes and folders of pieces fit; lists them.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise AssetError(f"{folder}: no such folder of objects")
    called = {path: path.stem if _is_mesh(path) else path.name for path in sorted(folder.iterdir())}
    plain = _plain(name)
    for rule in (
        lambda own: own == name,
        lambda own: _plain(own) == plain,
        lambda own: plain and _plain(own).endswith(plain),
    ):
        # The name comes first: to look into each of a thousand folders for each of a thousand names takes minutes.
        fits = [path for path, own in called.items() if rule(own) and _is_object(path)]
        cut = {called[path] for path in fits if path.is_dir()}
        fits = [path for path in fits if path.is_dir() or called[path] not in cut]
        if len(fits) == 1:
            return fits[0]
        if fits:
            raise AssetError(f"object '{name}' could be any of {_listing(fits)} in {folder}")
    raise AssetError(f"no mesh of object '{name}' in {folder}; there are {_listing(filter(_is_object, called))}")


def _from_folder(folder: Path, scale: float, candidates: int, seed: int) -> Object:
    """The object whose convex pieces are the meshes of `folder`.

    Raises:
        MeshError: it has no meshes, all are flat, or one cannot be read.
    """
    name = Path(os.path.abspath(folder)).name
    files = _piece_files(folder)
    if not files:
        raise MeshError(
            f"{folder}: has no meshes of convex pieces, nor has its {PIECES.as_posix()} ({', '.join(SUFFIXES)})"
        )
    loaded = [_load_piece(path, scale) for path in files]
    pieces = [piece for piece, _ in loaded if piece is not None]
    notes = [note for _, note in loaded if note is not None]
    if not pieces:
        raise MeshError(f"{folder}: no usable convex piece, all are flat: {_listing(files)}")
    mesh, more = _surface(folder, pieces, scale)
    body = build_body(name, pieces, candidates=candidates, seed=seed)
    return Object(name, mesh, body, convex=len(pieces) == 1, notes=(*notes, *more))


def _load_piece(path: Path, scale: float) -> tuple[Piece | None, str | None]:
    """The hull of a mesh, None if that is flat; and what the user should know about it, if anything.

    Raises:
        MeshError: the mesh is missing, unreadable, not finite or empty: without it the object would have a gap.
    """
    try:
        mesh = load_mesh(path, scale)
        piece = hull(mesh.vertices, name=str(path))
    except FlatMeshError:
        return None, f"{path.name}: flat; dropped"
    try:
        volume = watertight(mesh, path.name)[0].volume
    except MeshError:
        return piece, f"{path.name}: not watertight, so not known to be convex; its hull is used"
    excess = piece.mesh().volume / volume - 1
    if excess > MOST_EXCESS:
        return piece, f"{path.name}: not convex; its hull is used, which has {excess:.1%} more volume"
    return piece, None


def _surface(folder: Path, pieces: list[Piece], scale: float) -> tuple[trimesh.Trimesh, tuple[str, ...]]:
    """What is shown of an object with given pieces, in metres, and notes about it.

    Raises:
        MeshError: the surface in `folder` is unreadable, flat or empty.
    """
    import trimesh

    path = folder / SURFACE
    others = _meshes(path.parent)
    if not path.is_file() and len(others) == 1:
        (path,) = others
    if not path.is_file():
        return trimesh.util.concatenate([piece.mesh() for piece in pieces]), ()
    mesh = load_mesh(path, scale)
    try:
        return watertight(mesh, path.name)
    except MeshError:
        return mesh, (f"{path.name}: not watertight; it is only shown, the pieces are what is touched",)


def _piece_files(folder: Path) -> list[Path]:
    """The meshes of convex pieces in the folder of an object, in the order of their names; none if it has none."""
    return _meshes(folder / PIECES) or _meshes(folder)


def _meshes(folder: Path) -> list[Path]:
    return sorted(filter(_is_mesh, folder.iterdir())) if folder.is_dir() else []


def _is_mesh(path: Path) -> bool:
    return path.suffix.lower() in SUFFIXES


def _is_object(path: Path) -> bool:
    """Whether `path` is a mesh or a folder of convex pieces."""
    return bool(_piece_files(path)) if path.is_dir() else _is_mesh(path)


def _plain(name: str) -> str:
    return name.replace("-", "").replace("_", "").lower()


def _listing(paths: Iterable[Path]) -> str:
    names = [f"{path.name}/" if path.is_dir() else path.name for path in paths]
    return ", ".join(names) or f"no meshes ({', '.join(SUFFIXES)})"
