"""Visual geometry of links, as opposed to their collision geometry."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from grasp_refine.core.errors import HandError, MeshError
from grasp_refine.hands.files.description import read_visuals
from grasp_refine.hands.files.link_geometry import scaled
from grasp_refine.hands.files.mesh_files import read_mesh, resolve_mesh
from grasp_refine.hands.files.shape import MeshFile, Shape, Surface

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, eq=False)
class Visual:
    """One visual of a link."""

    link: str
    """Name of the link."""
    mesh: trimesh.Trimesh
    """Its surface in the link frame, metres; it may be open."""
    color: tuple[float, float, float] | None
    """Red, green and blue in [0, 1] from the file; None where it gives none."""


def load_visuals(
    path: Path, links: Collection[str], on_message: Callable[[str], None] = lambda line: None
) -> list[Visual]:
    """Visuals of `links` in the URDF or MJCF file `path`, where they have any, in the order of the file.

    A visual that cannot be read is left out, and `on_message` gets a line on it. A mesh file is read once.

    Raises:
        HandError: the file is missing, or neither of the two.
    """
    meshes: dict[Path, trimesh.Trimesh] = {}
    found = []
    for link, visuals in read_visuals(path).items():
        for visual in visuals if link in links else ():
            try:
                if isinstance(visual, HandError):
                    raise visual
                found.append(Visual(link, _mesh(visual, path, meshes), visual.color))
            except (HandError, MeshError) as error:
                reason = str(error).removeprefix(f"{path}: ").removeprefix(f"link '{link}': ")
                on_message(f"link '{link}': a visual cannot be read: {reason}")
    return found


def _mesh(visual: Shape, hand: Path, meshes: dict[Path, trimesh.Trimesh]) -> trimesh.Trimesh:
    geometry = visual.geometry
    if isinstance(geometry, MeshFile):
        path = resolve_mesh(geometry.filename, hand)
        if path not in meshes:
            meshes[path] = read_mesh(path)
        mesh = scaled(meshes[path], geometry.scale)
    elif isinstance(geometry, Surface):
        mesh = geometry.mesh()
    else:
        mesh = geometry.piece().mesh()
    return mesh.apply_transform(visual.T_link_shape)
