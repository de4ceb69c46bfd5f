"""The collision geometry of links as convex pieces: primitives as they are, meshes as their hulls or finer."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.errors import HandError, MeshError
from grasp_refine.geometry.covering import Covering, covering
from grasp_refine.geometry.pieces import Piece, box, cylinder, sphere
from grasp_refine.hands.mesh_files import read_mesh, resolve_mesh

if TYPE_CHECKING:
    import trimesh
    import yourdfpy

HULL_LIMIT = 5e-3
"""Greatest distance in metres by which the hull of a link's mesh may stand out of it; beyond, more pieces are used.

Meshes made for collision queries keep within 0.3 mm, on five hands. Detailed ones of fingertips and knuckles stand out
by 1 to 4 mm, but in sockets and behind nails: by less than 0.05 mm where objects touch, so that cutting them changes no
contact. Palms and forearms of several bodies stand out by 6 to 30 mm.
"""

Scale = tuple[float, float, float]
"""Factors along x, y and z; negative ones mirror."""


@dataclass(eq=False)
class LinkMeshes:
    """The meshes of the links of one URDF as convex pieces, each file read once and each size of it cut once."""

    urdf: Path
    """The file that names the meshes."""
    limit: float = HULL_LIMIT
    """Greatest distance in metres by which a hull may stand out of its mesh; infinite: only hulls."""
    cache: Path | None = None
    """Folder of earlier decompositions; None: no cache."""
    progress: Callable[[str], None] = lambda line: None
    """Called with a line before and one after a mesh is cut by CoACD."""
    _read: dict[Path, trimesh.Trimesh] = field(default_factory=dict)
    _cut: dict[tuple[Path, Scale], Covering] = field(default_factory=dict)
    _users: dict[tuple[Path, Scale], list[str]] = field(default_factory=dict)

    def pieces(self, filename: str, scale: Iterable[float], link: str) -> tuple[Piece, ...]:
        """The pieces of the mesh that the URDF calls `filename`, times `scale`, for `link`.

        Raises:
            HandError: there is no such file.
            MeshError: it cannot be used.
        """
        x, y, z = map(float, scale)
        path = resolve_mesh(filename, self.urdf)
        key = (path, (x, y, z))
        if key not in self._cut:
            if path not in self._read:
                self._read[path] = read_mesh(path)
            name = path.name if key[1] == (1.0, 1.0, 1.0) else f"{path.name} x {np.array(key[1])}"
            self._cut[key] = covering(
                scaled(self._read[path], key[1]), self.limit, cache=self.cache, progress=self.progress, name=name
            )
        users = self._users.setdefault(key, [])
        if link not in users:
            users.append(link)
        return self._cut[key].pieces

    def notes(self) -> list[str]:
        """A line on each mesh whose hull stands out of it noticeably: links, distance, and geometry used."""
        notes = []
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


def link_pieces(link: yourdfpy.Link, meshes: LinkMeshes) -> tuple[Piece, ...]:
    """The convex pieces of `link` in its frame, of all its <collision> elements; a repeated element counts once.

    Raises:
        HandError: a mesh file is missing or cannot be used, or a piece has no thickness; names the link.
    """
    pieces: list[Piece] = []
    for collision in link.collisions:
        try:
            found = _pieces(collision.geometry, meshes, link.name)
        except (HandError, MeshError) as error:
            raise HandError(f"{meshes.urdf}: link '{link.name}': {error}") from None
        for piece in found:
            if collision.origin is not None:
                piece = piece.transformed(collision.origin)
            # Two pieces in one place would each hide the other's surface.
            if not any(np.array_equal(piece.vertices, p.vertices) and piece.radius == p.radius for p in pieces):
                pieces.append(piece)
    return tuple(pieces)


def primitive(geometry: yourdfpy.Geometry) -> Piece | None:
    """The box, cylinder or sphere that a <geometry> holds; None if that is a mesh.

    Raises:
        MeshError: a size is not positive.
    """
    if geometry.box is not None:
        return box(geometry.box.size)
    if geometry.cylinder is not None:
        return cylinder(geometry.cylinder.radius, geometry.cylinder.length)
    if geometry.sphere is not None:
        return sphere(geometry.sphere.radius)
    return None


def _pieces(geometry: yourdfpy.Geometry, meshes: LinkMeshes, link: str) -> tuple[Piece, ...]:
    if (piece := primitive(geometry)) is not None:
        return (piece,)
    scale = np.ones(3) if geometry.mesh.scale is None else np.broadcast_to(geometry.mesh.scale, 3)
    return meshes.pieces(geometry.mesh.filename, scale, link)


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
