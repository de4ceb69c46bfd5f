"""Triangle meshes from files: loaded, scaled to metres, checked, and closed or refused."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.errors import MeshError

if TYPE_CHECKING:
    import trimesh

SUFFIXES = (".obj", ".stl", ".ply", ".glb", ".off")
"""File formats that are read."""

THINNEST = 1e-6
"""Smallest extent along the principal axes, as a fraction of the diagonal, that does not count as flat."""


class FlatMeshError(MeshError):
    """A mesh whose points span no volume: fewer than four, all in one place, or in one plane."""


def load_mesh(path: str | Path, scale: float = 1.0) -> trimesh.Trimesh:
    """The mesh of a file times `scale`, in metres: geometries joined, equal vertices merged, no materials.

    Raises:
        MeshError: the file is missing, unreadable, or of another format; `scale` is not positive and finite;
            or the mesh fails `check_mesh`.
    """
    import trimesh

    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise MeshError(f"{path}: unknown mesh type '{path.suffix}', use one of {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise MeshError(f"{path}: no such mesh file")
    if not (np.isfinite(scale) and scale > 0):
        raise MeshError(f"{path}: the scale must be positive and finite, got {scale:g}")
    options = {"skip_materials": True} if path.suffix.lower() in (".obj", ".glb") else {}
    try:
        scene = trimesh.load_scene(path, process=False, **options)
        loaded = scene.to_mesh()
    # The readers raise whatever a broken file makes them trip over.
    except Exception as error:
        raise MeshError(f"{path}: cannot be read as a mesh ({type(error).__name__}: {error})") from error
    mesh = trimesh.Trimesh(np.asarray(loaded.vertices) * scale, loaded.faces, process=False)
    check_mesh(mesh, str(path))
    # The merge distance is 1e-8 of the mesh's own size: an absolute one would eat a mesh of 0.1 mm.
    mesh.merge_vertices(digits_vertex=int(np.ceil(8 - np.log10(_diagonal(mesh.vertices[mesh.faces])))))
    a, b, c = mesh.faces.T
    mesh.update_faces((a != b) & (b != c) & (c != a))
    mesh.remove_unreferenced_vertices()
    return mesh


def check_mesh(mesh: trimesh.Trimesh, name: str) -> None:
    """Nothing, when `mesh` has faces whose vertices are finite and span a volume.

    Raises:
        FlatMeshError: the vertices span no volume.
        MeshError: says what else is wrong with `name`.
    """
    if len(mesh.faces) == 0:
        raise MeshError(f"{name}: empty, it has no faces")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise MeshError(f"{name}: its faces refer to vertices beyond the {len(mesh.vertices)} that it has")
    check_solid(mesh.vertices[np.unique(mesh.faces)], name)


def check_solid(points: np.ndarray, name: str) -> None:
    """Nothing, when `points` (N, 3) are finite and span a volume.

    Collision libraries take flat, collinear or non-finite points in silence, or crash.

    Raises:
        FlatMeshError: the points span no volume.
        MeshError: says what else is wrong with `name`.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4:
        raise FlatMeshError(f"{name}: at least 4 points (N, 3) are needed, got an array of shape {points.shape}")
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise MeshError(f"{name}: {(~finite).sum()} of its {len(points)} vertices are not finite")
    diagonal = _diagonal(points)
    if not 1e-50 < diagonal < 1e50:
        error = FlatMeshError if diagonal < 1 else MeshError
        raise error(f"{name}: its diagonal is {diagonal:g} m, which no solid has")
    centered = (points - points.mean(0)) / diagonal
    thickness = np.ptp(centered @ np.linalg.svd(centered, full_matrices=False)[2].T, axis=0).min()
    if thickness < THINNEST:
        raise FlatMeshError(f"{name}: flat, {thickness:.1e} of its diagonal thick ({THINNEST:g} is needed)")


def watertight(mesh: trimesh.Trimesh, name: str) -> tuple[trimesh.Trimesh, tuple[str, ...]]:
    """`mesh` with a closed surface whose normals point outward, and a note on each change that this took.

    A closed mesh comes back as it is; otherwise duplicate faces are dropped, single triangles and quads that
    are missing are filled, and the faces are turned consistently. An inverted mesh is turned inside out.

    Raises:
        MeshError: the surface is still open, or encloses nothing.
    """
    notes = []
    if not _closed(mesh):
        before = len(mesh.faces)
        mesh = mesh.copy()
        mesh.update_faces(mesh.unique_faces())
        mesh.fill_holes()
        mesh.fix_normals()
        if not _closed(mesh):
            open_edges = int((np.bincount(mesh.edges_unique_inverse) % 2).sum())
            raise MeshError(
                f"{name}: not watertight, {open_edges} edges stay open after repair; close its holes in a "
                "mesh editor (Blender: Select Non Manifold, then Fill; MeshLab: Close Holes), or use its hull"
            )
        notes.append(f"{name}: repaired to be watertight ({before} faces before, {len(mesh.faces)} after)")
    volume = _volume(mesh)
    if volume < 0:
        mesh = mesh.copy()
        mesh.invert()
        notes.append(f"{name}: was inside out; its faces are turned over")
    if abs(volume) < 1e-12 * _diagonal(mesh.vertices) ** 3:
        raise MeshError(f"{name}: its surface encloses no volume (a sheet, or one folded onto itself)")
    return mesh, tuple(notes)


def is_convex(mesh: trimesh.Trimesh, tolerance: float = 1e-3) -> bool:
    """Whether the closed `mesh` is one connected body that fills more than `1 - tolerance` of its hull."""
    from scipy.spatial import ConvexHull

    return bool(mesh.body_count == 1 and _volume(mesh) > (1 - tolerance) * ConvexHull(mesh.vertices).volume)


def _closed(mesh: trimesh.Trimesh) -> bool:
    """Whether each directed edge is matched by its reverse.

    Unlike trimesh's own test this lets two closed parts touch along an edge; the volume is well defined.
    """
    a, b = np.asarray(mesh.edges).T
    count = len(mesh.vertices)
    return bool(np.array_equal(np.sort(a * count + b), np.sort(b * count + a)))


def _volume(mesh: trimesh.Trimesh) -> float:
    """Signed volume of a closed mesh; trimesh's own divides by it."""
    a, b, c = np.moveaxis(np.asarray(mesh.triangles) - mesh.vertices.mean(axis=0), 1, 0)
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def _diagonal(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(np.reshape(points, (-1, 3)), axis=0)))
