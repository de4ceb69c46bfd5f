"""Objects: a mesh in metres and the convex pieces that stand for it in collision queries."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from grasp_refine.errors import AssetError, MeshError
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.cache import default_cache
from grasp_refine.geometry.decomposition import Decomposition
from grasp_refine.geometry.mesh import SUFFIXES, Holes, is_convex, load_mesh, watertight
from grasp_refine.geometry.pieces import Piece, convex_pieces
from grasp_refine.geometry.shapes import EMBEDDED, primitive, primitive_pieces
from grasp_refine.geometry.units import UNITS, Unit, check_size
from grasp_refine.names import is_folder
from grasp_refine.object_folders import given_pieces, surface

if TYPE_CHECKING:
    import trimesh

PRIMITIVE_FORMS = "box:x,y,z, sphere:r, cylinder:r,h (metres)"


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
    unit: Unit | None = "m",
    decomposition: Decomposition | None = None,
    holes: Holes = "refuse",
    candidates: int = 1024,
    seed: int = 0,
    cache: Path | Literal["user"] | None = "user",
    progress: Callable[[str], None] | None = None,
) -> Object:
    """The object, cut into convex pieces, that `source` names: embedded, a primitive, a mesh file, a folder of pieces.

    The hulls of the meshes in a folder (see `object_folders`) are the convex pieces; nothing is decomposed. What is
    shown is the folder's surface if it has one, else all pieces. A mesh file of convex bodies is not decomposed either.

    Args:
        source: name in EMBEDDED, "box:x,y,z", "sphere:r", "cylinder:r,h", or a path.
        scale: factor that takes the mesh, or the pieces, to metres.
        unit: of what the scale makes of it; another one than metres, or None, which is metres that nobody has said,
            is asked about where no hand grasps what comes out.
        decomposition: how a concave mesh is cut into convex pieces; the defaults when None.
        holes: what becomes of a mesh with holes: an error, flat caps on flat holes, or its convex hull.
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
    scale *= (factor := UNITS[unit or "m"])
    pieces: Sequence[Piece] = ()
    notes: tuple[str, ...] = ()
    # An empty path would be the present folder.
    if text and (text not in EMBEDDED or isinstance(source, Path)) and is_folder(Path(text)):
        name = Path(os.path.abspath(text)).name
        pieces, notes = given_pieces(Path(text), scale)
        mesh, more = surface(Path(text), pieces, scale)
        notes += more
    elif Path(text).suffix.lower() in SUFFIXES or isinstance(source, Path):
        name, mesh = Path(text).stem, load_mesh(text, scale)
    elif text in EMBEDDED:
        name, mesh = text, EMBEDDED[text]().apply_scale(scale)
    elif ":" in text:
        name, mesh = text, primitive(text).apply_scale(scale)
        pieces = [Piece(p.vertices * scale, p.faces, p.radius * scale) for p in primitive_pieces(text)]
    elif "/" in text or Path(text).suffix:
        name, mesh = Path(text).stem, load_mesh(text, scale)
    else:
        raise AssetError(
            f"no object '{text}': embedded ones are {', '.join(EMBEDDED)}; "
            f"primitives are {PRIMITIVE_FORMS}; "
            f"or give a mesh file ({', '.join(SUFFIXES)}), or a folder of meshes that are its convex pieces"
        )
    check_size(mesh.extents / factor, unit, text)
    convex = len(pieces) == 1
    if not pieces:
        mesh, notes = watertight(mesh, name, holes)
        # An object's notes are told after its name.
        notes = tuple(note.removeprefix(f"{name}: ") for note in notes)
        convex = is_convex(mesh)
        folder = default_cache() if cache == "user" else cache
        pieces = convex_pieces(mesh, decomposition, cache=folder, progress=progress, name=name)
    body = build_body(name, pieces, candidates=candidates, seed=seed)
    return Object(name, mesh, body, convex, notes)
