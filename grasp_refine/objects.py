"""Objects: a mesh in metres and the convex pieces that stand for it in collision queries."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from grasp_refine.errors import AssetError, MeshError
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.cache import default_cache
from grasp_refine.geometry.mesh import SUFFIXES, is_convex, load_mesh, watertight
from grasp_refine.geometry.pieces import Decomposition, Piece, convex_pieces
from grasp_refine.geometry.shapes import EMBEDDED, primitive, primitive_pieces

if TYPE_CHECKING:
    import trimesh

PRIMITIVE_FORMS = "box:x,y,z, sphere:r, cylinder:r,h (metres)"


@dataclass(frozen=True, eq=False)
class Object:
    """Something to grasp, at rest in its own frame."""

    name: str
    """Embedded name, primitive, or stem of the mesh file."""
    mesh: trimesh.Trimesh
    """Watertight surface, metres; what is shown."""
    body: Body
    """Convex pieces and surface candidates; what is touched."""
    convex: bool
    """Whether one piece stands for the mesh exactly."""
    notes: tuple[str, ...]
    """What was repaired in the mesh, for the user."""


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
    """Return the object that `source` names: an embedded one, a primitive, or a mesh file.

    Args:
        source: name in EMBEDDED, "box:x,y,z", "sphere:r", "cylinder:r,h", or a path.
        scale: factor that takes the mesh to metres.
        decomposition: how a concave mesh is cut into convex pieces; the defaults when None.
        candidates: number of points on the surface.
        seed: of the surface points.
        cache: folder of decompositions made before; "user" is the user's cache folder, None keeps none.
        progress: gets one line when a decomposition starts and one when it is done.

    Raises:
        AssetError: no such name.
        MeshError: the mesh is missing, unreadable, open, flat or empty, or the scale is not positive.
    """
    text = str(source)
    if not (np.isfinite(scale) and scale > 0):
        raise MeshError(f"{text}: the scale must be positive and finite, got {scale:g}")
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
            f"primitives are {PRIMITIVE_FORMS}; or give a mesh file ({', '.join(SUFFIXES)})"
        )
    mesh, notes = watertight(mesh, name)
    folder = default_cache() if cache == "user" else cache
    pieces = convex_pieces(mesh, decomposition, cache=folder, progress=progress, name=name)
    body = build_body(name, pieces, candidates=candidates, seed=seed)
    return Object(name, mesh, body, convex=is_convex(mesh), notes=notes)


def find_object(name: str, folder: str | Path) -> Path:
    """Return the mesh in `folder` that `name` means, as a grasp file may call it.

    That is the one whose stem is `name`, else the one whose stem is it, else the one whose stem ends with it,
    the last two whatever the case and without `-` and `_`.

    Raises:
        AssetError: the folder is missing, or none or several of its meshes fit; lists them.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise AssetError(f"{folder}: no such folder of objects")
    meshes = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    plain = _plain(name)
    for fits in (
        [path for path in meshes if path.stem == name],
        [path for path in meshes if _plain(path.stem) == plain],
        [path for path in meshes if plain and _plain(path.stem).endswith(plain)],
    ):
        if len(fits) == 1:
            return fits[0]
        if fits:
            raise AssetError(f"object '{name}' could be any of {_listing(fits)} in {folder}")
    raise AssetError(f"no mesh of object '{name}' in {folder}; there are {_listing(meshes)}")


def _plain(name: str) -> str:
    return name.replace("-", "").replace("_", "").lower()


def _listing(meshes: list[Path]) -> str:
    return ", ".join(path.name for path in meshes) or f"no meshes ({', '.join(SUFFIXES)})"
