"""Collision geometry of links as convex pieces: primitives exactly, meshes as their hulls or finer."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.errors import HandError, MeshError
from grasp_refine.core.plurals import count_text, names_text
from grasp_refine.geometry.covering import Covering, covering
from grasp_refine.geometry.mesh import FlatMeshError
from grasp_refine.geometry.pieces import Piece
from grasp_refine.hands.files.mesh_files import read_mesh, resolve_mesh
from grasp_refine.hands.files.shape import Geometry, MeshFile, Scale, Surface
from grasp_refine.hands.files.tree import LinkEntry

if TYPE_CHECKING:
    import trimesh

HULL_LIMIT = 5e-3
"""Greatest distance in metres by which the hull of a link's mesh may stand out of it; beyond, more pieces are used.

Meshes made for collision queries keep within 0.3 mm, on five hands. Detailed ones of fingertips and knuckles stand out
by 1 to 4 mm, but in sockets and behind nails: by less than 0.05 mm where objects touch, so that cutting them changes no
contact. Palms and forearms of several bodies stand out by 6 to 30 mm.
"""


@dataclass(eq=False)
class LinkMeshes:
    """The mesh files of the links of one hand as convex pieces, each read once and each size of it cut once."""

    path: Path
    """The file that names them."""
    limit: float = HULL_LIMIT
    """Greatest distance in metres by which a hull may stand out of its mesh; infinite: only hulls."""
    cache: Path | None = None
    """Folder of earlier decompositions; None: no cache."""
    progress: Callable[[str], None] = lambda line: None
    """Called with a line before and one after a mesh is cut by CoACD."""
    _read: dict[Path, trimesh.Trimesh] = field(default_factory=dict)
    _cut: dict[tuple[Path, Scale], Covering] = field(default_factory=dict)
    _users: dict[tuple[Path, Scale], list[str]] = field(default_factory=dict)
    _flat: dict[str, list[str]] = field(default_factory=dict)

    def require(self, links: Iterable[LinkEntry]) -> None:
        """Check that all mesh files of links exist, before any is cut, which may take minutes.

        Raises:
            HandError: a file is missing; names its link, where it was sought, and how many others are.
        """
        meshes: dict[str, str] = {}
        for link in links:
            for shape in link.collisions:
                if isinstance(shape.geometry, MeshFile):
                    meshes.setdefault(shape.geometry.filename, link.name)
        missing = []
        for name, link_name in meshes.items():
            try:
                resolve_mesh(name, self.path)
            except HandError as error:
                missing.append(f"{self.path}: link '{link_name}': {error}")
        if missing:
            others = count_text(len(missing) - 1, "other mesh is", "other meshes are")
            raise HandError(missing[0] + f"; {others} missing, too" * (len(missing) > 1))

    def pieces(self, mesh: MeshFile, link: str) -> tuple[Piece, ...]:
        """The pieces of a mesh file, for `link`.

        A flat one, such as a sticker with a marker, has none, and a note says so.

        Raises:
            HandError: there is no such file.
            MeshError: it cannot be used; or a scale of 0 makes it flat.
        """
        path = resolve_mesh(mesh.filename, self.path)
        key = (path, mesh.scale)
        if key not in self._cut:
            try:
                if path not in self._read:
                    self._read[path] = read_mesh(path)
                name = path.name if key[1] == (1.0, 1.0, 1.0) else f"{path.name} x {np.array(key[1])}"
                self._cut[key] = covering(
                    scaled(self._read[path], key[1]), self.limit, cache=self.cache, progress=self.progress, name=name
                )
            except FlatMeshError:
                if not all(key[1]):
                    raise
                self._flat.setdefault(path.name, []).append(link)
                return ()
        users = self._users.setdefault(key, [])
        if link not in users:
            users.append(link)
        return self._cut[key].pieces

    def notes(self) -> list[str]:
        """A line on each mesh that is flat, or whose hull stands out of it noticeably: links, distance, geometry."""
        notes = [f"{names_text(links)}: {name} is flat and does not collide" for name, links in self._flat.items()]
        for (path, scale), cut in self._cut.items():
            if cut.hull_stands_out == 0:
                continue
            links = ", ".join(self._users[path, scale])
            note = f"{links}: the hull of {path.name} stands out of it by up to {_millimetres(cut.hull_stands_out)}"
            if len(cut.pieces) > 1:
                by = f"up to {_millimetres(cut.stands_out)}"
                if cut.stands_out == 0:
                    by = f"less than {_millimetres(cut.least)}"
                note += f"; instead, {len(cut.pieces)} convex pieces stand out by {by}"
                note += ", more than the limit" if cut.stands_out > self.limit else ""
            elif cut.hull_stands_out <= self.limit:
                note += f", within the limit of {_millimetres(self.limit)}"
            else:
                note += f"; it is used nevertheless ({cut.trouble})"
            notes.append(note + (f" ({cut.trouble})" if cut.trouble and len(cut.pieces) > 1 else ""))
        return notes


def link_pieces(link: LinkEntry, meshes: LinkMeshes) -> tuple[Piece, ...]:
    """The convex pieces of `link` in its frame, of all its collision geometry; a repeated element counts once.

    Raises:
        HandError: a mesh file is missing or cannot be used, or a piece has no thickness; names the link.
    """
    pieces: list[Piece] = []
    for shape in link.collisions:
        try:
            found = _pieces(shape.geometry, meshes, link.name)
        except (HandError, MeshError) as error:
            raise HandError(f"{meshes.path}: link '{link.name}': {error}") from None
        moved = not np.array_equal(shape.T_link_shape, np.eye(4))
        for piece in found:
            piece = piece.transformed(shape.T_link_shape) if moved else piece
            # Two pieces in one place would each hide the other's surface.
            if not any(np.array_equal(piece.vertices, p.vertices) and piece.radius == p.radius for p in pieces):
                pieces.append(piece)
    return tuple(pieces)


def _pieces(geometry: Geometry, meshes: LinkMeshes, link: str) -> tuple[Piece, ...]:
    assert not isinstance(geometry, Surface)  # surfaces are for display
    return meshes.pieces(geometry, link) if isinstance(geometry, MeshFile) else (geometry.piece(),)


def scaled(mesh: trimesh.Trimesh, scale: Scale) -> trimesh.Trimesh:
    """A mesh stretched and mirrored, its faces still looking outward."""
    import trimesh

    faces = np.asarray(mesh.faces)
    mirrored = np.prod(np.sign(scale)) < 0
    with np.errstate(over="ignore", invalid="ignore"):  # an overflow is refused later
        vertices = np.asarray(mesh.vertices) * scale
    return trimesh.Trimesh(vertices, faces[:, ::-1] if mirrored else faces, process=False)


def _millimetres(metres: float) -> str:
    return f"{metres * 1e3:.1f} mm"
