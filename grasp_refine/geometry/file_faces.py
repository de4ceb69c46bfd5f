"""Faces of a mesh file as it has them, before any repair: in their order, and with their colours."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.errors import MeshError
from grasp_refine.geometry.mesh import quietly

if TYPE_CHECKING:
    import trimesh


def numbered_triangles(path: Path, scale: float) -> tuple[Float[np.ndarray, "F 3 3"], Int[np.ndarray, " F"]]:
    """Return the corners (F, 3, 3) of the triangles of a file times `scale`, and the numbers (F,) of their faces.

    Faces are numbered from 0 in the order of the file. In an OBJ file they may have any number of corners; faces of
    other files count as triangles.

    Raises:
        MeshError: the file cannot be read.
    """
    if path.suffix.lower() == ".obj":
        triangles, number = _obj_triangles(path)
    else:
        triangles = np.concatenate([np.zeros((0, 3, 3)), *(np.asarray(mesh.triangles) for mesh in _meshes(path))])
        number = np.arange(len(triangles))
    return scale * triangles, number


def _obj_triangles(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles and the numbers of their faces; readers of OBJ files put them in order of their materials."""
    vertices: list[list[float]] = []
    corners: list[tuple[int, int, int]] = []
    numbers: list[int] = []
    faces = 0
    try:
        for line in path.read_text(encoding="utf-8", errors="replace").replace("\\\n", " ").splitlines():
            words = line.split()
            if words[:1] == ["v"]:
                vertices.append([float(word) for word in words[1:4]])
            elif words[:1] == ["f"]:
                index = [int(word.partition("/")[0]) for word in words[1:]]
                # From 1 on, or from the last vertex so far back.
                index = [at - 1 if at > 0 else len(vertices) + at for at in index]
                corners += [(index[0], b, c) for b, c in pairwise(index[1:])]
                numbers += [faces] * (len(index) - 2)
                faces += 1
        triangles = np.array(vertices, dtype=float).reshape(-1, 3)[np.array(corners, dtype=int).reshape(-1, 3)]
    except (OSError, ValueError, IndexError) as error:
        raise MeshError(f"{path}: its faces cannot be read ({error})") from None
    return triangles, np.array(numbers, dtype=np.int64)


def colored_triangles(path: Path, scale: float) -> tuple[Float[np.ndarray, "F 3 3"], Int[np.ndarray, "F 3 3"]]:
    """Return the corners (F, 3, 3) of the triangles of a file times `scale`, and their colours, red, green, blue.

    Colours (F, 3, 3) at the corners come from faces, vertices, materials or textures, 0 to 255; -1: no colour.

    Raises:
        MeshError: the file cannot be read.
    """
    corners, colors = [np.zeros((0, 3, 3))], [np.zeros((0, 3, 3), dtype=np.int64)]
    for mesh in _meshes(path):
        corners.append(np.asarray(mesh.triangles))
        colors.append(_corner_colors(mesh).astype(np.int64))
    return scale * np.concatenate(corners), np.concatenate(colors)


def _meshes(path: Path) -> Iterator[trimesh.Trimesh]:
    """Yield the meshes of a file, each where it is in the whole.

    Raises:
        MeshError: the file cannot be read.
    """
    import trimesh

    try:
        with quietly():
            scene = trimesh.load_scene(path, process=False)
            # Nodes have no order; geometries have that of the file.
            place = {name: at for at, name in enumerate(scene.geometry)}
            for node in sorted(scene.graph.nodes_geometry, key=lambda node: place[scene.graph[node][1]]):
                T, name = scene.graph[node]
                if isinstance(mesh := scene.geometry[name], trimesh.Trimesh):
                    yield mesh.copy().apply_transform(T)
    # The readers may raise any exception on a broken file.
    except Exception as error:
        raise MeshError(f"{path}: its faces cannot be read ({type(error).__name__}: {error})") from error


def _corner_colors(mesh: trimesh.Trimesh) -> np.ndarray:
    """Return the colours (F, 3, 3) at the corners of the triangles of a mesh; -1: there is none."""
    visual: Any = mesh.visual
    if visual.kind == "face":
        return np.repeat(np.asarray(visual.face_colors)[:, None, :3], 3, axis=1)
    if visual.kind == "texture":
        images = (getattr(visual.material, name, None) for name in ("image", "baseColorTexture"))
        if visual.uv is None or all(image is None for image in images):
            return np.broadcast_to(np.asarray(visual.material.main_color)[:3], (len(mesh.faces), 3, 3))
        visual = visual.to_color()
    if visual.kind == "vertex":
        return np.asarray(visual.vertex_colors)[mesh.faces][..., :3]
    return np.full((len(mesh.faces), 3, 3), -1)
