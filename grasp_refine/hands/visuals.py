"""Visual geometry of links, as opposed to their collision geometry."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.core.errors import HandError, MeshError
from grasp_refine.hands.link_geometry import primitive, scaled
from grasp_refine.hands.mesh_files import read_mesh, resolve_mesh
from grasp_refine.hands.urdf import read_visuals

if TYPE_CHECKING:
    import trimesh
    import yourdfpy


@dataclass(frozen=True, eq=False)
class Visual:
    """One <visual> of a link."""

    link: str
    """Name of the link."""
    mesh: trimesh.Trimesh
    """Its surface in the link frame, metres; it may be open."""
    color: tuple[float, float, float] | None
    """Red, green and blue in [0, 1] from the URDF; None where it gives none."""


def load_visuals(
    urdf: Path, links: Collection[str], on_message: Callable[[str], None] = lambda line: None
) -> list[Visual]:
    """Visuals of those of `links` that have any in the file `urdf`, in the order of the file.

    A visual that cannot be read is left out, and `on_message` gets a line on it. A mesh file is read once.

    Raises:
        HandError: the file is missing, or not a URDF.
    """
    meshes: dict[Path, trimesh.Trimesh] = {}
    found = []
    for link, visuals in read_visuals(urdf).items():
        for visual in visuals if link in links else ():
            try:
                if isinstance(visual, HandError):
                    raise visual
                found.append(Visual(link, _mesh(visual, urdf, meshes), _color(visual)))
            except (HandError, MeshError) as error:
                reason = str(error).removeprefix(f"{urdf}: ").removeprefix(f"link '{link}': ")
                on_message(f"link '{link}': a visual cannot be read: {reason}")
    return found


def _mesh(visual: yourdfpy.Visual, urdf: Path, meshes: dict[Path, trimesh.Trimesh]) -> trimesh.Trimesh:
    geometry = visual.geometry
    piece = primitive(geometry)
    if piece is not None:
        mesh = piece.mesh()
    else:
        path = resolve_mesh(geometry.mesh.filename, urdf)
        if path not in meshes:
            meshes[path] = read_mesh(path)
        x, y, z = np.broadcast_to(1.0 if geometry.mesh.scale is None else geometry.mesh.scale, 3).tolist()
        mesh = scaled(meshes[path], (x, y, z))
    return mesh if visual.origin is None else mesh.apply_transform(visual.origin)


def _color(visual: yourdfpy.Visual) -> tuple[float, float, float] | None:
    if visual.material is None or visual.material.color is None:
        return None
    red, green, blue = np.clip(visual.material.color.rgba[:3], 0.0, 1.0).tolist()
    return red, green, blue
