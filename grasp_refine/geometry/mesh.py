"""Triangle meshes from files: load, scale to metres, check, and close or refuse."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

from grasp_refine.core.arguments import as_numbers
from grasp_refine.core.errors import GraspRefineError, MeshError
from grasp_refine.core.lfs_pointer import refuse_lfs_pointer
from grasp_refine.core.names import is_file
from grasp_refine.geometry.holes import cap_holes

if TYPE_CHECKING:
    import trimesh
    from numpy.typing import ArrayLike

T = TypeVar("T")

SUFFIXES = (".obj", ".stl", ".ply", ".glb", ".off")
"""Supported file formats."""

Holes = Literal["refuse", "cap", "hull"]
"""Treatment of a mesh with holes: an error, flat caps on flat holes, or its convex hull."""

MIN_THICKNESS_RATIO = 1e-6
"""Smallest extent of a solid along its principal axes, as a fraction of the diagonal."""

MIN_DIAGONAL, MAX_DIAGONAL = 1e-15, 1e15
"""Limits of a solid's diagonal, in metres or the unit of the file: a nucleus, a light-month."""

MAX_OPEN_SHARE = 0.05
"""Area of the open sides of a mesh, over that of its hull, above which the hull is doubtful: a side was never seen.

Of 61 objects, the surface that one camera sees has 0.02 to 0.64, all but the least 5 % above 0.063; a mesh without
1 % of its faces has at most 0.026.
"""

MAX_BODIES = 64
"""Most connected bodies taken as one piece each; a mesh with more is decomposed, even if all are convex."""


@contextmanager
def quietly() -> Iterator[None]:
    """Silence trimesh within the block: its log messages about broken files are for programmers."""
    logger = logging.getLogger("trimesh")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        logger.setLevel(level)


def check_unpacked(path: Path) -> None:
    """Refuse a zip, whatever its suffix: a reader would unpack any amount.

    Raises:
        MeshError: it is a zip.
    """
    with path.open("rb") as file:
        if file.read(2) == b"PK":
            raise MeshError(f"{path}: is a zip, not a mesh; unpack it, and name the mesh in it")


class FlatMeshError(MeshError):
    """A mesh whose points span no volume: fewer than four, coincident, or coplanar."""


def load_mesh(path: str | Path, scale: float = 1.0) -> trimesh.Trimesh:
    """Load the mesh of a file times `scale`, in metres: geometries joined, equal vertices merged, no materials.

    Raises:
        MeshError: the file is missing, unreadable, or of another format; `scale` is not positive and finite;
            or the mesh fails `check_mesh`.
    """
    path = Path(path)
    return _merge(_read(path, scale, lambda scene: scene.to_mesh()), scale, str(path))


def mesh_of(vertices: ArrayLike, faces: ArrayLike, scale: float, name: str) -> trimesh.Trimesh:
    """Return the mesh of vertices (V, 3) and faces (F, 3) times `scale`, in metres, as `load_mesh` that of a file.

    Raises:
        MeshError: the arrays are no triangles, or the mesh fails `check_mesh`.
    """
    import trimesh

    try:
        points = as_numbers(f"{name}: vertices", vertices, "V", 3)
        corners = as_numbers(f"{name}: faces", faces, "F", 3, why="triangles, as indices of their vertices")
    except GraspRefineError as error:
        raise MeshError(str(error)) from None
    if len(corners) and not ((corners % 1 == 0) & (corners >= 0) & (corners < len(points))).all():
        raise MeshError(f"{name}: faces must be indices of its {len(points)} vertices")
    return _merge(trimesh.Trimesh(points, corners.astype(np.int64), process=False), scale, name)


def load_groups(path: Path, scale: float = 1.0) -> tuple[tuple[str, trimesh.Trimesh | None], ...]:
    """Load name and mesh of each object in an OBJ file, sorted by name, each as in `load_mesh`; None if flat.

    Raises:
        MeshError: as in `load_mesh`.
    """

    def groups(scene: trimesh.Scene) -> list[tuple[str, trimesh.Trimesh]]:
        return sorted(scene.geometry.items(), key=lambda item: ([*map(int, re.findall(r"\d+", item[0]))], item[0]))

    found: list[tuple[str, trimesh.Trimesh | None]] = []
    for name, group in _read(path, scale, groups, split_objects=True):
        try:
            found.append((name, _merge(group, scale, f"{path}: {name}")))
        except FlatMeshError:
            found.append((name, None))
    return tuple(found)


def _read(path: Path, scale: float, take: Callable[[trimesh.Scene], T], **options: Any) -> T:
    """Load a file and return `take` of its scene; checks the file and the `scale` to be applied."""
    import trimesh

    if path.suffix.lower() not in SUFFIXES:
        raise MeshError(f"{path}: unknown mesh type '{path.suffix}', use one of {', '.join(SUFFIXES)}")
    if not is_file(path):
        raise MeshError(f"{path}: no such mesh file")
    refuse_lfs_pointer(path, "mesh", MeshError)
    if not (np.isfinite(scale) and scale > 0):
        raise MeshError(f"{path}: the scale must be positive and finite, got {scale:g}")
    check_unpacked(path)
    if path.suffix.lower() in (".obj", ".glb"):
        options["skip_materials"] = True
    try:
        with quietly():
            return take(trimesh.load_scene(path, process=False, **options))
    # The readers may raise any exception on a broken file.
    except Exception as error:
        raise MeshError(f"{path}: cannot be read as a mesh ({type(error).__name__}: {error})") from error


def _merge(loaded: trimesh.Trimesh, scale: float, name: str) -> trimesh.Trimesh:
    """Mesh in metres, checked, with equal vertices merged."""
    import trimesh

    with quietly():
        mesh = trimesh.Trimesh(np.asarray(loaded.vertices) * scale, loaded.faces, process=False)
    check_mesh(mesh, name)
    mesh.remove_unreferenced_vertices()
    # The merge distance is 1e-8 of the mesh's own size: an absolute one would collapse a mesh of 0.1 mm.
    mesh.merge_vertices(digits_vertex=int(np.ceil(8 - np.log10(_diagonal(mesh.vertices[mesh.faces])))))
    a, b, c = mesh.faces.T
    mesh.update_faces((a != b) & (b != c) & (c != a))
    mesh.remove_unreferenced_vertices()
    return mesh


def check_mesh(mesh: trimesh.Trimesh, name: str) -> None:
    """Refuse a mesh without faces, or whose vertices are not finite or span no volume.

    Raises:
        FlatMeshError: the vertices span no volume.
        MeshError: any other fault of `name`.
    """
    if len(mesh.faces) == 0:
        raise MeshError(f"{name}: empty, it has no faces")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise MeshError(f"{name}: its faces refer to vertices beyond its {len(mesh.vertices)}")
    check_solid(mesh.vertices[np.unique(mesh.faces)], name)


def check_solid(points: np.ndarray, name: str) -> None:
    """Refuse `points` (N, 3) that are not finite or span no volume.

    Collision libraries accept flat, collinear or non-finite points silently, or crash.

    Raises:
        FlatMeshError: the points span no volume.
        MeshError: any other fault of `name`.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4:
        raise FlatMeshError(f"{name}: at least 4 points (N, 3) are needed, got an array of shape {points.shape}")
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise MeshError(f"{name}: {(~finite).sum()} of its {len(points)} vertices are not finite")
    diagonal = _diagonal(points)
    if not MIN_DIAGONAL < diagonal < MAX_DIAGONAL:
        error = FlatMeshError if diagonal < 1 else MeshError
        raise error(f"{name}: its diagonal is {diagonal:g} m, which no solid has")
    centered = (points - points.mean(0)) / diagonal
    thickness = np.ptp(centered @ np.linalg.svd(centered, full_matrices=False)[2].T, axis=0).min()
    if thickness < MIN_THICKNESS_RATIO:
        raise FlatMeshError(f"{name}: flat, {thickness:.1e} of its diagonal thick ({MIN_THICKNESS_RATIO:g} is needed)")


def watertight(mesh: trimesh.Trimesh, name: str, holes: Holes = "refuse") -> tuple[trimesh.Trimesh, tuple[str, ...]]:
    """Close the surface of `mesh`, with normals outward; also returns a note on each change.

    A closed mesh is returned unchanged; otherwise duplicate faces are dropped, single missing triangles and quads
    are filled, and the faces are oriented consistently. Remaining holes are closed only as `holes` specifies: a
    paper cup and a solid one without its top look the same. An inverted mesh is turned inside out.

    Raises:
        MeshError: the surface is still open, or encloses nothing.
    """
    notes = []
    if not is_closed(mesh):
        before = len(mesh.faces)
        mesh = mesh.copy()
        with quietly():
            mesh.update_faces(mesh.unique_faces())
            mesh.fill_holes()
            mesh.fix_normals()
        closed = is_closed(mesh)
        if closed or len(mesh.faces) != before:
            what = "repaired to be watertight" if closed else "repaired in part"
            notes.append(f"{name}: {what} ({before} faces before, {len(mesh.faces)} after)")
        if not closed:
            mesh, note = _without_holes(mesh, name, holes)
            notes.append(note)
    volume = _volume(mesh)
    if volume < 0:
        mesh = mesh.copy()
        mesh.invert()
        notes.append(f"{name}: was inside out; its faces are flipped")
    if abs(volume) < 1e-12 * _diagonal(mesh.vertices) ** 3:
        raise MeshError(f"{name}: its surface encloses no volume (a sheet, or one folded onto itself)")
    return mesh, tuple(notes)


def _without_holes(mesh: trimesh.Trimesh, name: str, holes: Holes) -> tuple[trimesh.Trimesh, str]:
    """Return a closed mesh in place of the open `mesh`, and a note on the change.

    Raises:
        MeshError: holes are refused, or cannot be cap_holes.
    """
    open_edges = int((np.bincount(mesh.edges_unique_inverse) % 2).sum())
    if holes == "hull":
        # Scaled to unit size: trimesh merges points closer than 1e-8.
        size = _diagonal(mesh.vertices)
        body = mesh.copy().apply_scale(1 / size).convex_hull.apply_scale(size)
        note = f"{name}: not watertight, {open_edges} edges are open; its convex hull is used"
        if (share := open_share(mesh)) > MAX_OPEN_SHARE:
            note += (
                f", although its open side is {share:.0%} of it: where nothing was seen, the object may be larger by "
                "far; give the position of the sensor (`seen_from`), and the mesh counts as a scan"
            )
        return body, note
    reason = ""
    if holes == "cap":
        try:
            closed, what = cap_holes(mesh)
            if is_closed(closed):
                return closed, f"{name}: {what}"
            reason = ", also with flat caps"
        except MeshError as error:
            reason = f": {error}"
    raise MeshError(
        f"{name}: not watertight, {open_edges} edges stay open after repair{reason}; close its holes in a mesh editor "
        "(Blender: Select Non Manifold, then Fill; MeshLab: Close Holes), or have them closed flat (`holes='cap'`), or "
        "use its convex hull (`holes='hull'`); or give the position of the sensor (`seen_from`) where it is a scan, of "
        "an object that was seen in part"
    )


def is_convex(mesh: trimesh.Trimesh, tolerance: float = 1e-3) -> bool:
    """Return whether the closed `mesh` is one connected body that fills more than `1 - tolerance` of its hull."""
    from scipy.spatial import ConvexHull

    return bool(mesh.body_count == 1 and _volume(mesh) > (1 - tolerance) * ConvexHull(mesh.vertices).volume)


def convex_bodies(mesh: trimesh.Trimesh, tolerance: float = 1e-3) -> tuple[np.ndarray, ...]:
    """Points (V, 3) of each connected body of the closed `mesh` if all are convex as in `is_convex`, else empty.

    Bodies may overlap. A cavity is an inverted body, so the result is empty for a hollow mesh.
    """
    from scipy.spatial import ConvexHull

    if mesh.body_count > MAX_BODIES:
        return ()
    bodies = []
    for body in mesh.split(only_watertight=False, repair=False):
        points = body.vertices[np.unique(body.faces)]
        try:
            check_solid(points, "body")
        except MeshError:
            return ()
        if not is_closed(body) or _volume(body) <= (1 - tolerance) * ConvexHull(points).volume:
            return ()
        bodies.append(points)
    return tuple(bodies)


def is_closed(mesh: trimesh.Trimesh) -> bool:
    """Return whether each directed edge is matched by its reverse.

    Unlike trimesh's own test this allows two closed parts to touch along an edge; the volume is well defined.
    """
    a, b = np.asarray(mesh.edges).T
    count = len(mesh.vertices)
    return bool(np.array_equal(np.sort(a * count + b), np.sort(b * count + a)))


def open_share(mesh: trimesh.Trimesh) -> float:
    """Return the area of flat caps on the holes of `mesh`, whose faces are oriented consistently, over its hull's area.

    A rim's cap has half the sum of the cross products of the rim's edges as its vector area, however it is bent.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(mesh.vertices)
    a, b = np.asarray(mesh.edges).T
    rim = ~np.isin(a * count + b, b * count + a)
    if not rim.any():
        return 0.0
    a, b = a[rim], b[rim]
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(count, count))
    hole = connected_components(graph, directed=False)[1][a]
    points = np.asarray(mesh.vertices) - mesh.vertices.mean(axis=0)
    caps = np.zeros((hole.max() + 1, 3))
    np.add.at(caps, hole, np.cross(points[a], points[b]) / 2)
    size = _diagonal(mesh.vertices)
    area = mesh.copy().apply_scale(1 / size).convex_hull.area * size**2
    return float(np.linalg.norm(caps, axis=1).sum() / area)


def _volume(mesh: trimesh.Trimesh) -> float:
    """Signed volume of a closed mesh; trimesh's own divides by it."""
    a, b, c = np.moveaxis(np.asarray(mesh.triangles) - mesh.vertices.mean(axis=0), 1, 0)
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def _diagonal(points: np.ndarray) -> float:
    with np.errstate(over="ignore"):
        return float(np.linalg.norm(np.ptp(np.reshape(points, (-1, 3)), axis=0)))
