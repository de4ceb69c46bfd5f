"""Convex pieces of bodies, and the decomposition of closed meshes into them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from grasp_refine.core.cores import usable_cores
from grasp_refine.core.errors import GraspFileError, MeshError
from grasp_refine.core.plurals import count_text
from grasp_refine.core.short_repr import brief
from grasp_refine.geometry import cache as disk
from grasp_refine.geometry.decomposition import Decomposition, OutOfTimeError, decompose
from grasp_refine.geometry.mesh import MAX_DIAGONAL, MIN_DIAGONAL, check_solid, convex_bodies
from grasp_refine.geometry.rings import Rings
from grasp_refine.geometry.simplification import simplify

if TYPE_CHECKING:
    import trimesh

SHIPPED = Path(__file__).parent / "embedded_pieces"
"""Convex pieces of the embedded objects, written by `cut_embedded.py` of the application."""

MIN_VOLUME_RATIO = 1e-9
"""Smallest volume of a piece, as a fraction of the cubed diagonal of the mesh; smaller ones are dropped."""

SIMPLIFICATION_RATIO = 0.005
"""Distance of a simplified mesh from a mesh of diagonal 1, where the time is short."""

PROGRESS_INTERVAL_S = 10.0
"""Time between two lines on a decomposition that is running, in seconds."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A convex piece of a body, in its frame: the Minkowski sum of a polytope core and a ball of `radius`."""

    vertices: np.ndarray
    """Core (V, 3) in metres: V = 1 is a sphere, V = 2 a capsule, V >= 4 a polytope (hull vertices only)."""
    faces: np.ndarray
    """Triangles (F, 3) of the core, counter-clockwise seen from outside; (0, 3) for spheres and capsules."""
    radius: float = 0.0
    """Radius of the ball in metres; 0 for a plain polytope."""

    __repr__ = brief

    def transformed(self, T: np.ndarray) -> Piece:
        """The piece moved by the rigid transform `T` (4, 4), which maps its present frame to the new one."""
        return Piece(self.vertices @ T[:3, :3].T + T[:3, 3], self.faces, self.radius)

    def scaled(self, factor: float) -> Piece:
        """The piece `factor` times as large about the origin of its frame."""
        return Piece(self.vertices * factor, self.faces, self.radius * factor)

    @cached_property
    def bounds(self) -> np.ndarray:
        """Lower and upper corner (2, 3) of the axis-aligned bounding box, radius included."""
        return np.stack([self.vertices.min(0) - self.radius, self.vertices.max(0) + self.radius])

    @cached_property
    def diagonal(self) -> float:
        """Diagonal of the bounding box in metres."""
        return float(np.linalg.norm(np.ptp(self.bounds, axis=0)))

    @cached_property
    def extent(self) -> float:
        """Diameter in metres of the sphere about the mean vertex that holds the core: the same in any frame."""
        return 2.0 * float(np.linalg.norm(self.vertices - self.vertices.mean(axis=0), axis=1).max())

    @cached_property
    def normals(self) -> np.ndarray:
        """Unit outward normals (F, 3) of the faces; zero for a sliver, whose own normal would be noise."""
        corners = self.vertices[self.faces]
        double_area = 2.0 * self.areas[:, None]
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        solid = double_area > 1e-8 * edges.max(1, initial=0.0, keepdims=True) ** 2
        return np.where(solid, self._crosses / np.where(solid, double_area, 1.0), 0.0)

    @cached_property
    def areas(self) -> np.ndarray:
        """Areas (F,) of the faces of the core, in square metres."""
        return 0.5 * np.linalg.norm(self._crosses, axis=1)

    @cached_property
    def _crosses(self) -> np.ndarray:
        """Products (F, 3) of two edges of each face: outward, twice as long as its area."""
        corners = self.vertices[self.faces]
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    @cached_property
    def planes(self) -> tuple[np.ndarray, np.ndarray]:
        """Unit normals (P, 3) and offsets (P,) of the core's half-spaces `n . x <= offset`; 0 for V <= 2."""
        # Slivers are left out: their half-spaces are implied by the faces around them.
        solid = self.normals.any(axis=1)
        normals, corners = self.normals[solid], self.vertices[self.faces[solid]]
        return normals, np.einsum("fij,fj->fi", corners, normals).max(1, initial=-np.inf)

    @cached_property
    def derived(self) -> dict[str, Any]:
        """Structures that other modules built from the piece, by name, so that each is built once."""
        return {}

    def __getstate__(self) -> dict[str, Any]:
        """State of the piece for another process, without `derived`, which that process builds itself."""
        return {name: value for name, value in self.__dict__.items() if name != "derived"}

    def rings(self, edges: int) -> Rings:
        """The vertices within `edges` edges of each vertex of the core or, with a radius, of `mesh()`; built once."""
        if edges not in self._rings:
            surface = self.mesh() if self.radius > 0 else self
            self._rings[edges] = Rings.of(np.asarray(surface.vertices), np.asarray(surface.faces), edges)
        return self._rings[edges]

    @cached_property
    def _rings(self) -> dict[int, Rings]:
        return {}

    def mesh(self) -> trimesh.Trimesh:
        """Closed surface of the piece for display; round parts have their vertices on the true surface."""
        import trimesh

        core = self
        if self.radius > 0:
            ball = trimesh.creation.icosphere(subdivisions=3).vertices
            core = hull((self.vertices[:, None] + self.radius * ball).reshape(-1, 3))
        return trimesh.Trimesh(core.vertices, core.faces, process=False)


def joined_mesh(pieces: Sequence[Piece]) -> trimesh.Trimesh:
    """Return the surfaces of pieces as one mesh for display."""
    import trimesh

    whole = trimesh.util.concatenate([piece.mesh() for piece in pieces])
    assert isinstance(whole, trimesh.Trimesh)
    return whole


def hull(points: ArrayLike, *, name: str = "convex piece") -> Piece:
    """The convex hull of `points` (N, 3) as a polytope piece.

    Raises:
        MeshError: `name` has fewer than 4 points, points that are not finite, or no thickness.
    """
    from scipy.spatial import ConvexHull, QhullError

    points = np.asarray(points, dtype=np.float64)
    check_solid(points, name)
    center = (points.min(0) + points.max(0)) / 2
    size = np.ptp(points, axis=0).max()
    try:
        # Qhull tests flatness in absolute coordinates: give it a unit-sized set about the origin.
        qhull = ConvexHull((points - center) / size, qhull_options="Qt")
    except QhullError as error:
        reason = str(error).splitlines()[0]
        raise MeshError(f"{name}: no convex hull of its {len(points)} points ({reason})") from None
    corners = qhull.points[qhull.simplices]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("fi,fi->f", cross, qhull.equations[:, :3]) < 0
    simplices = np.where(inward[:, None], qhull.simplices[:, ::-1], qhull.simplices)
    used, faces = np.unique(simplices, return_inverse=True)
    return Piece(points[used], faces.reshape(-1, 3).astype(np.int64))


def sphere(radius: float, center: ArrayLike = (0.0, 0.0, 0.0)) -> Piece:
    """An exact sphere of `radius` metres about `center` (3,).

    Raises:
        MeshError: the radius is not positive and finite, or the centre is not finite.
    """
    return _round_piece(radius, [center], "sphere")


def capsule(radius: float, a: ArrayLike, b: ArrayLike) -> Piece:
    """An exact capsule: all points within `radius` metres of the segment from `a` to `b`; a sphere if a = b.

    Raises:
        MeshError: the radius is not positive and finite, or an end is not finite.
    """
    return _round_piece(radius, [a] if np.array_equal(a, b) else [a, b], "capsule")


def box(extents: ArrayLike, T: np.ndarray | None = None) -> Piece:
    """A box with full side lengths `extents` (3,) in metres, centred at and aligned with frame `T` (4, 4).

    Raises:
        MeshError: a side length is not positive and finite.
    """
    half = _check_positive(extents, "box: side lengths") / 2
    corners = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return hull(_transform(corners, T), name="box")


def cylinder(radius: float, length: float, T: np.ndarray | None = None, sides: int = 96) -> Piece:
    """A regular prism inscribed in the cylinder of `radius` and `length` metres, centred on z of `T` (4, 4).

    Its surface lies within `radius * (1 - cos(pi / sides))` of the cylinder's: 0.054 % of the radius for 96.

    Raises:
        MeshError: the radius or the length is not positive and finite, or there are fewer than 3 sides.
    """
    if sides < 3:
        raise MeshError(f"cylinder: at least 3 sides are needed, got {sides}")
    radius, length = _check_positive([radius, length], "cylinder: radius and length")
    angles = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(sides, length / 2)], axis=1)
    return hull(_transform(np.concatenate([ring, ring * [1, 1, -1]]), T), name="cylinder")


def ellipsoid(semi_axes: ArrayLike) -> Piece:
    """A polyhedron of 642 vertices inscribed in the ellipsoid with `semi_axes` (3,) in metres, about the origin.

    Its surface lies within 0.4 % of the largest semi-axis of the ellipsoid's.

    Raises:
        MeshError: a semi-axis is not positive and finite.
    """
    import trimesh

    semi_axes = _check_positive(semi_axes, "ellipsoid: semi-axes")
    return hull(semi_axes * trimesh.creation.icosphere(subdivisions=3).vertices, name="ellipsoid")


@dataclass(frozen=True, eq=False)
class Cut:
    """Convex pieces of a mesh, and a reason why they are coarser than asked for."""

    pieces: tuple[Piece, ...]
    """Convex pieces, in metres."""
    shortfall: str = ""
    """Note for the user that the time was too short for the settings; empty: it was not."""


def convex_pieces(
    mesh: trimesh.Trimesh,
    config: Decomposition | None = None,
    *,
    cache: Path | None = None,
    progress: Callable[[str], None] | None = None,
    name: str = "mesh",
) -> tuple[Piece, ...]:
    """Return the convex pieces of one closed `mesh`, see `cut_meshes`."""
    return cut_meshes([(name, mesh)], config, cache=cache, progress=progress)[0].pieces


def cut_meshes(
    meshes: Sequence[tuple[str, trimesh.Trimesh]],
    config: Decomposition | None = None,
    *,
    cache: Path | None = None,
    workers: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> list[Cut]:
    """Cut named closed meshes into convex pieces: the bodies of a mesh if all are convex, else its parts by CoACD.

    CoACD's input is the mesh divided by its diagonal and rounded to 1e-9, so that one decomposition, and an entry of
    the folder `cache` (None: no cache), serves the same mesh at every scale. Pieces of the embedded objects come with
    the program. As many meshes as there are `workers` (None: cores) are decomposed at a time, which changes no piece,
    and each is saved as soon as it is done. `progress` is called with a line before and one after each decomposition,
    and every `PROGRESS_INTERVAL_S` meanwhile.

    On a mesh that takes longer than `config.time_limit`, coarser settings are tried on a simpler mesh for half that
    time; then its convex hull is used. Such pieces have entries of their own in the cache, and a `Cut.shortfall`.

    Raises:
        MeshError: CoACD fails on a mesh, or finds no solid piece.
    """
    config, report = config or Decomposition(), progress or (lambda line: None)
    pieces: dict[int, tuple[Piece, ...]] = {}
    concave: dict[int, _UnitMesh] = {}
    parts: dict[str, list[disk.Polytope]] = {}
    shortfalls: dict[str, str] = {}
    waiting: dict[str, _UnitMesh] = {}
    for number, (name, mesh) in enumerate(meshes):
        if bodies := convex_bodies(mesh):
            pieces[number] = tuple(hull(points, name=name) for points in bodies)
            continue
        unit = concave[number] = _UnitMesh.of(mesh, config, name)
        known = disk.load(SHIPPED / unit.shipped) or (cache and disk.load(cache / unit.entry))
        if unit.entry in parts:
            continue
        if known:
            parts[unit.entry] = known
        elif cache and (known := disk.load(cache / unit.short_entry)):
            parts[unit.entry], shortfalls[unit.entry] = known, _shortfall(known, config)
            report(f"{name}: {shortfalls[unit.entry]}")
        else:
            waiting.setdefault(unit.entry, unit)
    for done, (unit, found) in enumerate(_decompose_all(list(waiting.values()), config, workers, report), 1):
        parts[unit.entry] = solid = _solid_hulls(found.parts)
        dropped = len(found.parts) - len(solid)
        if not solid:
            raise MeshError(f"{unit.name}: CoACD found no solid piece in it ({dropped} flat ones)")
        flat = f", {dropped} flat ones dropped" if dropped else ""
        of_all = f"; {done} of {len(waiting)} objects done" if len(waiting) > 1 else ""
        if found.short:
            shortfalls[unit.entry] = _shortfall(solid, config)
            flat += f"; {shortfalls[unit.entry]}"
        report(f"{unit.name}: {count_text(len(solid), 'convex piece')} in {found.seconds:.1f} s{flat}{of_all}")
        try:
            if cache:
                disk.save(cache / (unit.short_entry if found.short else unit.entry), solid)
        except GraspFileError as error:
            report(f"{unit.name}: the pieces could not be cached ({error})")
    for number, unit in concave.items():
        pieces[number] = tuple(Piece(corners * unit.diagonal, faces) for corners, faces in parts[unit.entry])
    return [
        Cut(pieces[number], shortfalls.get(concave[number].entry, "") if number in concave else "")
        for number in range(len(meshes))
    ]


def unit_pieces(
    mesh: trimesh.Trimesh, config: Decomposition | None = None, *, name: str = "mesh"
) -> tuple[str, list[disk.Polytope]]:
    """File name in `SHIPPED` and newly cut pieces, at a diagonal of 1, of a concave closed `mesh`.

    Raises:
        MeshError: CoACD fails on it.
    """
    config = config or Decomposition()
    unit = _UnitMesh.of(mesh, config, name)
    return unit.shipped, _solid_hulls(decompose(unit.vertices, unit.faces, config, single=unit.single))


@dataclass(frozen=True, eq=False)
class _UnitMesh:
    """A concave mesh, normalised for CoACD."""

    name: str
    """Name in messages."""
    vertices: np.ndarray
    """Vertices (V, 3), divided by the diagonal and rounded."""
    faces: np.ndarray
    """Triangles (F, 3)."""
    diagonal: float
    """Diagonal of the mesh in metres."""
    single: bool
    """Whether the mesh is one closed part."""
    entry: str
    """File name of its pieces in a cache."""
    short_entry: str
    """File name in a cache of coarser pieces, for want of time."""
    shipped: str
    """File name of its pieces in `SHIPPED`, independent of the installed CoACD."""

    @staticmethod
    def of(mesh: trimesh.Trimesh, config: Decomposition, name: str) -> _UnitMesh:
        """Normalise a closed mesh in metres, to be cut with `config`."""
        diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
        # Adding 0 turns -0 into 0, which has other bytes.
        vertices = np.round(np.asarray(mesh.vertices, dtype=np.float64) / diagonal, 9) + 0.0
        faces = np.ascontiguousarray(mesh.faces, dtype=np.int64)
        single = bool(mesh.is_watertight and mesh.is_winding_consistent and mesh.body_count == 1)
        coacd = f" coacd {version('coacd')}"
        entry, short_entry, shipped = (
            disk.entry_name(vertices, faces, f"{config.search}{more}")
            for more in (coacd, f"{coacd} within {config.time_limit:g} s", "")
        )
        return _UnitMesh(name, vertices, faces, diagonal, single, entry, short_entry, shipped)


@dataclass(frozen=True, eq=False)
class _Found:
    """Result of a decomposition."""

    parts: list[np.ndarray]
    """Corners (V, 3) of each part."""
    seconds: float
    """Wall time."""
    short: bool
    """Whether the time was too short, so that the parts are coarser than asked for."""


def _decompose_all(
    units: Sequence[_UnitMesh], config: Decomposition, workers: int | None, report: Callable[[str], None]
) -> Iterator[tuple[_UnitMesh, _Found]]:
    """Yield each mesh with its parts, in order of completion; one failure ends all.

    Raises:
        MeshError: CoACD ended without a result.
    """
    ending = threading.Event()
    workers = max(min(workers or usable_cores(), len(units)), 1)
    threads = max(usable_cores() // workers, 1)

    def check() -> None:
        if ending.is_set():
            raise CancelledError

    def timed(unit: _UnitMesh) -> _Found:
        start = time.perf_counter()
        try:
            found, short = _decompose_in_time(unit, config, threads, check)
        except MeshError as error:
            raise MeshError(f"{unit.name}: {error}") from None
        return _Found(found, time.perf_counter() - start, short)

    if len(units) > 1:
        report(
            f"cutting {len(units)} objects, {workers} at a time; each is saved when it is done "
            "(`object_name` selects the grasps of one)"
        )
    running: dict[Future[_Found], tuple[_UnitMesh, float]] = {}
    with ThreadPoolExecutor(workers) as pool:
        try:
            for unit in units:
                if len(running) == workers:
                    yield from _take_finished(running, report)
                threshold = f"threshold {config.threshold:g}"
                report(
                    f"decomposing {unit.name} ({len(unit.faces)} faces) with CoACD, {threshold}, "
                    f"up to {config.time_limit:g} s of processor time ..."
                )
                running[pool.submit(timed, unit)] = unit, time.perf_counter()
            while running:
                yield from _take_finished(running, report)
        finally:
            ending.set()


def _decompose_in_time(
    unit: _UnitMesh, config: Decomposition, threads: int, check: Callable[[], None]
) -> tuple[list[np.ndarray], bool]:
    """Return the parts of a mesh, and whether they are coarser than asked for: the hull at the worst.

    Raises:
        MeshError: CoACD ended without a result, though in time.
    """
    try:
        return decompose(unit.vertices, unit.faces, config, single=unit.single, threads=threads, check=check), False
    except OutOfTimeError:
        vertices, faces = simplify(unit.vertices, unit.faces, SIMPLIFICATION_RATIO)
    try:
        return decompose(vertices, faces, config.coarser(), single=unit.single, threads=threads, check=check), True
    except MeshError:
        return [unit.vertices], True


def _shortfall(pieces: Sequence[disk.Polytope], config: Decomposition) -> str:
    """Note on pieces that are coarser than asked for."""
    used = "its convex hull is used"
    if len(pieces) > 1:
        used = f"{len(pieces)} coarser pieces are used, threshold {config.coarser().threshold:g} on a simpler mesh"
    return f"CoACD needs more than {config.time_limit:g} s of processor time, so {used}"


def _take_finished(
    running: dict[Future[_Found], tuple[_UnitMesh, float]], report: Callable[[str], None]
) -> Iterator[tuple[_UnitMesh, _Found]]:
    """Wait for the first of `running` to finish, remove them from it, and yield their results."""
    while not (done := wait(running, timeout=PROGRESS_INTERVAL_S, return_when=FIRST_COMPLETED).done):
        for unit, start in running.values():
            report(f"decomposing {unit.name} for {time.perf_counter() - start:.0f} s ...")
    for future in done:
        unit, _ = running.pop(future)
        yield unit, future.result()


def _solid_hulls(parts: Sequence[np.ndarray]) -> list[disk.Polytope]:
    """Hulls of the parts of a mesh of diagonal 1 that have a volume.

    A cut along a wall can leave a flat sheet, which is no part of the body.
    """
    solid = []
    for corners in parts:
        try:
            piece = hull(corners)
        except MeshError:
            continue
        if piece.mesh().volume > MIN_VOLUME_RATIO:
            solid.append((piece.vertices, piece.faces))
    return solid


def _round_piece(radius: float, points: Sequence[ArrayLike], name: str) -> Piece:
    vertices = np.array(points, dtype=np.float64).reshape(-1, 3)
    if not np.isfinite(vertices).all():
        raise MeshError(f"{name}: its centre or an end is not finite: {vertices.tolist()}")
    if 0 < radius < MIN_DIAGONAL or MAX_DIAGONAL < radius < np.inf:
        raise MeshError(f"{name}: its radius is {radius:g} m, which no solid has")
    return Piece(vertices, np.zeros((0, 3), dtype=np.int64), float(_check_positive(radius, f"{name}: radius")))


def _check_positive(values: ArrayLike, what: str) -> np.ndarray:
    values = np.asarray(values, dtype=np.float64)
    if not (np.isfinite(values) & (values > 0)).all():
        raise MeshError(f"{what} must be positive and finite, got {values.tolist()}")
    return values


def _transform(points: np.ndarray, T: np.ndarray | None) -> np.ndarray:
    return points if T is None else points @ np.asarray(T)[:3, :3].T + np.asarray(T)[:3, 3]
