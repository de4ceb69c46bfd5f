"""Faces of a mesh file as it has them, before any repair: in their order, and with their colours."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from grasp_refine.core.errors import MeshError
from grasp_refine.geometry.mesh import quietly

if TYPE_CHECKING:
    import trimesh


def numbered_triangles(path: Path, scale: float) -> Float[np.ndarray, "F 3 3"]:
    """Return the corners (F, 3, 3) of the triangles of a file times `scale`, in the order in which it lists them.

    A face of more corners counts as its triangles.

    Raises:
        MeshError: the file cannot be read.
    """
    # Readers of OBJ files put faces of one material together unless they are told not to.
    options = {"skip_materials": True, "group_material": False} if path.suffix.lower() == ".obj" else {}
    found = [np.asarray(mesh.triangles) for mesh in _meshes(path, options)]
    return scale * np.concatenate([np.zeros((0, 3, 3)), *found])


def colored_triangles(path: Path, scale: float) -> tuple[Float[np.ndarray, "F 3 3"], Int[np.ndarray, "F 3 3"]]:
    """Return the corners (F, 3, 3) of the triangles of a file times `scale`, and their colours, red, green, blue.

    Colours are those of faces, of vertices, of materials or of textures, 0 to 255; triangles without any are left out.

    Raises:
        MeshError: the file cannot be read.
    """
    corners, colors = [np.zeros((0, 3, 3))], [np.zeros((0, 3, 3), dtype=np.int64)]
    for mesh in _meshes(path, {}):
        found = _corner_colors(mesh)
        if found is not None:
            corners.append(np.asarray(mesh.triangles))
            colors.append(found.astype(np.int64))
    return scale * np.concatenate(corners), np.concatenate(colors)


def _meshes(path: Path, options: dict[str, Any]) -> Iterator[trimesh.Trimesh]:
    """Yield the meshes of a file, each where it is in the whole.

    Raises:
        MeshError: the file cannot be read.
    """
    import trimesh

    try:
        with quietly():
            scene = trimesh.load_scene(path, process=False, **options)
            for node in scene.graph.nodes_geometry:
                T, name = scene.graph[node]
                if isinstance(mesh := scene.geometry[name], trimesh.Trimesh):
                    yield mesh.copy().apply_transform(T)
    # The readers may raise any exception on a broken file.
    except Exception as error:
        raise MeshError(f"{path}: its faces cannot be read ({type(error).__name__}: {error})") from error


def _corner_colors(mesh: trimesh.Trimesh) -> np.ndarray | None:
    """Return the colours (F, 3, 3) at the corners of the triangles of a mesh; None: it has none."""
    visual: Any = mesh.visual
    if visual.kind == "texture":
        if (
            visual.uv is None
            or getattr(visual.material, "image", getattr(visual.material, "baseColorTexture", None)) is None
        ):
            return np.broadcast_to(np.asarray(visual.material.main_color)[:3], (len(mesh.faces), 3, 3))
        return np.asarray(visual.to_color().vertex_colors)[mesh.faces][..., :3]
    if visual.kind == "face":
        return np.repeat(np.asarray(visual.face_colors)[:, None, :3], 3, axis=1)
    if visual.kind == "vertex":
        return np.asarray(visual.vertex_colors)[mesh.faces][..., :3]
    return None
