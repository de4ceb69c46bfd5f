"""Objects: a mesh in metres and the convex pieces that represent it in collision queries."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeGuard, cast

import numpy as np

from grasp_refine.core.arguments import check_kind, describe_value, is_number
from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import AssetError, GraspRefineError, MeshError
from grasp_refine.core.names import is_folder
from grasp_refine.core.plurals import count_text
from grasp_refine.geometry.body import Body, build_body
from grasp_refine.geometry.cache import default_cache
from grasp_refine.geometry.decomposition import Decomposition
from grasp_refine.geometry.mesh import SUFFIXES, Holes, is_convex, load_mesh, mesh_of, watertight
from grasp_refine.geometry.pieces import Cut, Piece, cut_meshes, hull, joined_mesh
from grasp_refine.geometry.sampling import check_drawing
from grasp_refine.geometry.shapes import EMBEDDED, primitive, primitive_pieces
from grasp_refine.geometry.surface_distance import surface_note
from grasp_refine.geometry.units import UNITS, Unit, check_size
from grasp_refine.hands.files.inertia import Inertia
from grasp_refine.objects.folders import given_pieces, surface
from grasp_refine.objects.seen import HYPOTHESES, Completing, record_of, seen_object
from grasp_refine.scans.hypothesis import Hypothesis
from grasp_refine.scans.reading import SCAN_SUFFIXES, Sensors, is_scan
from grasp_refine.scans.scan import Scan

if TYPE_CHECKING:
    import trimesh
    from numpy.typing import ArrayLike

    from grasp_refine.scans.depth_camera import Intrinsics

    Mesh: TypeAlias = trimesh.Trimesh | tuple[ArrayLike, ArrayLike]

PRIMITIVE_FORMS = "box:x,y,z, sphere:r, cylinder:r,h (metres)"


@dataclass(frozen=True, eq=False)
class Object:
    """Something to grasp, at rest in its own frame.

    A concave mesh is decomposed into convex pieces when they are first needed, which may take minutes, or by `prepare`.
    """

    name: str
    """Embedded name, primitive, stem of the mesh file, or name of the folder."""
    mesh: trimesh.Trimesh
    """Surface for display, metres. Watertight, unless there is a note that the surface beside given pieces is not."""
    convex: bool
    """Whether it is one convex piece."""
    repairs: tuple[str, ...] = ()
    """Repairs of the mesh, or faults of given pieces, for the user."""
    supplied: tuple[Piece, ...] = ()
    """Its convex pieces where they are given; none: the mesh is decomposed."""
    file: tuple[Path, float] | None = None
    """File of the mesh, and the factor that takes it to metres; None: it is of no single file."""
    beside: bool = False
    """Whether the mesh came beside the given pieces, so that it may differ from them."""
    decomposition: Decomposition = Decomposition()
    """Settings of the decomposition."""
    candidates: int = 1024
    """Number of points on the surface of the body."""
    seed: int = 0
    """Seed of these points."""
    cache: str | Path | None = "user"
    """Folder of earlier decompositions; "user" is the user's cache folder, None: no cache."""
    whole: Object | None = None
    """Object for which this one, its convex hull, stands until that is decomposed; None: it stands for none."""

    scan: Scan | None = None
    """Scan that this completes first; None: its surface is known."""
    hypotheses: tuple[Hypothesis, ...] = ()
    """Solids that a scanned object may be; the first stands for all."""
    record: Mapping[str, Any] | None = None
    """Arguments with which `load_object` reads the scan again, as JSON; None: it is in memory, or there is no scan."""

    def __repr__(self) -> str:
        size = " x ".join(f"{side * 1e3:.3g}" for side in self.mesh.extents)
        pieces = count_text(len(self.body.pieces), "convex piece") if self.is_decomposed else "not decomposed"
        return f"Object({self.name}: {size} mm, {pieces})"

    @property
    def body(self) -> Body:
        """Convex pieces and surface candidates, for contacts.

        Raises:
            MeshError: the mesh cannot be decomposed.
        """
        return self._decomposed[0]

    @cached_property
    def volume(self) -> float:
        """Sum of the volumes of its convex pieces, m^3."""
        return Inertia.of(self.body.pieces, density=1.0).mass

    @cached_property
    def center_of_mass(self) -> Float[np.ndarray, " 3"]:
        """Centre of mass (3,) at uniform density in its own frame, metres.

        A closed mesh determines it: the pieces overlap a little and fill small hollows. An open surface has no volume:
        there the pieces determine it, each with its own volume.
        """
        if self.mesh.is_volume:
            return np.asarray(self.mesh.center_mass, dtype=np.float64)
        return Inertia.of(self.body.pieces).centre

    @property
    def notes(self) -> tuple[str, ...]:
        """Repairs, and faults of its convex pieces, for the user."""
        return (*self.repairs, *self._decomposed[1])

    @property
    def is_decomposed(self) -> bool:
        """Whether its convex pieces are there."""
        return "_decomposed" in vars(self)

    @property
    def takes_long(self) -> bool:
        """Whether its mesh has to be decomposed, which may take minutes."""
        return not (self.is_decomposed or self.supplied or self.convex)

    @property
    def rough(self) -> bool:
        """Whether it is only the convex hull of an object that is not decomposed yet."""
        return self.whole is not None

    @cached_property
    def solids(self) -> tuple[Object, ...]:
        """Solids that a scanned object may be, as objects: itself first."""
        return self, *(self._solid(f"{self.name}, {other.kind}", other.pieces) for other in self.hypotheses[1:])

    @cached_property
    def weights(self) -> Float[np.ndarray, " K"]:
        """Probability (K,) of each of the `solids`."""
        return np.array([each.weight for each in self.hypotheses] or [1.0])

    @cached_property
    def envelope(self) -> Object:
        """Union of all solids that it may be; itself where its surface is known."""
        if len(self.hypotheses) < 2:
            return self
        pieces = tuple(piece for each in self.hypotheses for piece in each.pieces)
        return self._solid(f"{self.name}, all hypotheses", pieces)

    def _solid(self, name: str, pieces: tuple[Piece, ...]) -> Object:
        return replace(
            self,
            name=name,
            mesh=joined_mesh(pieces),
            convex=len(pieces) == 1,
            supplied=pieces,
            scan=None,
            hypotheses=(),
        )

    def as_hull(self) -> Object:
        """Return the convex hull of the object, to be shown until this is decomposed."""
        return Object(
            self.name, self.mesh, self.convex, self.repairs, (hull(self.mesh.vertices),), self.file, whole=self
        )

    def with_body(self, body: Body) -> Object:
        """Return the object with another body."""
        found = replace(self)
        vars(found)["_decomposed"] = body, self._decomposed[1] if self.is_decomposed else ()
        return found

    @cached_property
    def _decomposed(self) -> tuple[Body, tuple[str, ...]]:
        """Body, and notes on its pieces for the user."""
        (found,) = _decompose([self])
        return found


def load_object(
    source: str | Path | Mesh | Scan | None = None,
    *,
    points: ArrayLike | None = None,
    normals: ArrayLike | None = None,
    seen_from: str | Sequence[str] | ArrayLike | None = None,
    camera: str | Path | ArrayLike | None = None,
    intrinsics: str | Path | ArrayLike | Intrinsics | None = None,
    mask: str | Path | ArrayLike | None = None,
    hypotheses: int = HYPOTHESES,
    completions: str | Path | None = None,
    table: float | Sequence[ArrayLike] | None = None,
    name: str | None = None,
    scale: float = 1.0,
    unit: Unit | None = None,
    decomposition: Decomposition | None = None,
    holes: Holes = "refuse",
    candidates: int = 1024,
    seed: int = 0,
    cache: str | Path | None = "user",
) -> Object:
    """Return the object that `source` names or is: embedded, a primitive, a mesh, a folder of pieces, a scan.

    It is read and checked, and decomposed into convex pieces when they are first needed, or by `prepare`.

    The hulls of the meshes in a folder (see `folders`) are the convex pieces; nothing is decomposed. The
    displayed surface is the folder's if it has one, else all pieces. A mesh file of convex bodies is not decomposed
    either, and the pieces of the embedded objects come with the program.

    A scan is a point cloud (PLY, PCD, XYZ, NPZ), a depth picture (PNG, NPY, NPZ), `points` in memory, or a mesh that is
    open where `seen_from` or `camera` is given. The object is then the first of several `hypotheses` of the
    solid that was seen:

        gr.load_object("scan.ply", seen_from=(0, 0, 0.5))
        gr.load_object("depth.png", intrinsics=(600, 600, 320, 240), mask="mask.png", camera=T_object_camera)
        gr.load_object(points=points, normals=normals)

    Args:
        source: name in EMBEDDED, "box:x,y,z", "sphere:r", "cylinder:r,h", or a path; or a mesh in memory, a
            `trimesh.Trimesh` or a pair of vertices (V, 3) and faces (F, 3); or a `Scan`; None: `points`.
        points: points (P, 3) on the seen surface.
        normals: their normals (P, 3), out of the object; None: unknown, then a sensor has to be known.
        seen_from: position x, y, z, or several, of the sensor in the object's frame, metres.
        camera: pose (4, 4) of the camera in the object's frame, or several, or a file of them: OpenCV's axes, x to the
            right, y down, z forward, metres. Points are then in the camera's frame. Without it, the frame of a depth
            picture is the camera's.
        intrinsics: fx, fy, cx, cy of the camera of a depth picture in pixels, the matrix (3, 3), or a file of them.
        mask: picture or array that is not 0 where a depth picture shows the object; None: wherever it has a depth.
        hypotheses: number of solids that a scanned object may be.
        completions: folder of completed meshes of the scan by another program, which are the hypotheses instead;
            weights.toml in it has lines mesh = weight, else all are equally probable.
        table: height of a table in the object's frame, z up, on which a scanned object stands, or a point of it and its
            normal.
        name: of the object; None: that of the source, "object" for a mesh or points in memory.
        scale: factor that takes the mesh, the pieces, or the points to metres.
        unit: of the mesh times the scale. None is metres too, but a size that no hand grasps is then an error that
            asks for the unit; "m" accepts metres whatever the size. Depth pictures of integers are in millimetres.
        decomposition: settings for cutting a concave mesh into convex pieces; None: the defaults.
        holes: treatment of a mesh with holes: an error, flat caps on flat holes, or its convex hull.
        candidates: number of points on the surface.
        seed: of the surface points, and of the hypotheses.
        cache: folder of earlier decompositions; "user" is the user's cache folder, None: no cache.

    Raises:
        AssetError: no such name.
        MeshError: the mesh or scan is missing, unreadable, open, flat, empty or of a size that asks for its unit, a
            folder has no usable piece or one that cannot be read, the scale is not positive, or points are too few, a
            plane, or several objects.
        GraspRefineError: an argument of another kind, or one that does not fit the others.
    """
    if (source is None) == (points is None):
        raise GraspRefineError("give an object, or its points" + ("" if points is None else ", not both"))
    if not (source is None or is_mesh(source)):
        check_kind("source", source, str | Path | Scan)
    check_kind("name", name, str | None)
    check_kind("unit", unit, Unit | None)
    check_kind("decomposition", decomposition, Decomposition | None)
    check_kind("holes", holes, Holes)
    check_kind("candidates", candidates, int)
    check_kind("seed", seed, int)
    check_drawing(candidates, seed)
    check_kind("cache", cache, str | Path | None)
    settings = decomposition or Decomposition()
    in_memory = not isinstance(source, str | Path)
    text = (name or "object") if in_memory else str(source)
    if not (is_number(scale) and 0 < scale < np.inf):
        raise MeshError(f"{text}: the scale must be positive and finite, got {describe_value(scale)}")
    sensors = Sensors(seen_from, camera, intrinsics, mask)
    completing = Completing(hypotheses, completions, table)
    metres = scale * (factor := UNITS[unit or "m"])
    seen: Path | Scan | trimesh.Trimesh | None = None
    is_seen = source is None or isinstance(source, Scan)
    pieces: Sequence[Piece] = ()
    notes: tuple[str, ...] = ()
    file: tuple[Path, float] | None = None
    beside = False
    known = text
    # An empty path would be the current folder.
    named = not in_memory and text in EMBEDDED and not isinstance(source, Path)
    if is_seen:
        seen = cast(Scan | None, source)
    elif is_mesh(source):
        mesh = _mesh_in_memory(source, metres, text)
    elif text and not named and is_folder(Path(text)):
        known = Path(os.path.abspath(text)).name
        pieces, notes = given_pieces(Path(text), metres)
        mesh, more = surface(Path(text), pieces, metres)
        notes += more
        beside = not np.array_equal(mesh.vertices, np.concatenate([piece.vertices for piece in pieces]))
    elif not named and is_scan(Path(text)):
        known, seen, is_seen, file = Path(text).stem, Path(text), True, (Path(text), metres)
    elif Path(text).suffix.lower() in SUFFIXES or isinstance(source, Path):
        known, mesh, file = Path(text).stem, load_mesh(text, metres), (Path(text), metres)
    elif named:
        mesh = EMBEDDED[text]().apply_scale(metres)
    elif ":" in text:
        mesh = primitive(text).apply_scale(metres)
        pieces = [Piece(p.vertices * metres, p.faces, p.radius * metres) for p in primitive_pieces(text)]
    elif "/" in text or Path(text).suffix:
        known, mesh, file = Path(text).stem, load_mesh(text, metres), (Path(text), metres)
    else:
        raise AssetError(
            f"no object '{text}': embedded ones are {', '.join(EMBEDDED)}; "
            f"primitives are {PRIMITIVE_FORMS}; "
            f"or give a mesh file ({', '.join(SUFFIXES)}), a scan ({', '.join(SCAN_SUFFIXES)}), or a folder of meshes "
            "that are its convex pieces"
        )
    if not is_seen:
        check_size(mesh.extents / factor, unit, text)
        if sensors.known and not (pieces or named):
            seen, is_seen = mesh, True
    name = name or known
    if is_seen:
        scan, notes = seen_object(seen, points, normals, sensors, text, scale=scale, unit=unit)
        solids, more = completing.solids(
            scan, scale=metres, holes=holes, decomposition=settings, cache=_folder(cache), seed=seed
        )
        found = scanned_object(name, scan, solids, candidates=candidates, seed=seed)
        record = record_of(file[0], sensors, completing) if file else None
        return replace(found, repairs=(*notes, *more), file=file, record=record)
    if sensors.known or completions is not None or hypotheses != HYPOTHESES:
        raise GraspRefineError(f"{text}: its surface is known; sensors, hypotheses and completions are for scans")
    convex = len(pieces) == 1
    if not pieces:
        mesh, notes = watertight(mesh, name, holes)
        # An object's notes are printed after its name.
        notes = tuple(note.removeprefix(f"{name}: ") for note in notes)
        convex = is_convex(mesh)
    return Object(
        name,
        mesh,
        convex,
        notes,
        tuple(pieces),
        file,
        beside,
        settings,
        candidates=candidates,
        seed=seed,
        cache=cache,
    )


def scanned_object(
    name: str, scan: Scan, hypotheses: tuple[Hypothesis, ...], *, candidates: int = 1024, seed: int = 0
) -> Object:
    """Return the object of a scan: its first completion, which knows the scan and all completions.

    Args:
        name: Name of the object.
        scan: The scan.
        hypotheses: Completions; the first stands for all.
        candidates: Number of points on the surface of each.
        seed: Seed of these points.
    """
    pieces = hypotheses[0].pieces
    return Object(
        name,
        joined_mesh(pieces),
        len(pieces) == 1,
        supplied=pieces,
        candidates=candidates,
        seed=seed,
        scan=scan,
        hypotheses=hypotheses,
    )


def is_mesh(source: object) -> TypeGuard[Mesh]:
    """Return whether an object is given as a mesh in memory, see `load_object`."""
    return isinstance(source, tuple | list) or (hasattr(source, "vertices") and hasattr(source, "faces"))


def as_object(name: str, value: Object | Mesh) -> Object:
    """Return an argument as an object: itself, or loaded from a mesh in memory.

    Raises:
        MeshError: the mesh cannot be used.
        GraspRefineError: it is neither.
    """
    if is_mesh(value):
        return load_object(value)
    check_kind(name, value, Object)
    return cast(Object, value)


def _mesh_in_memory(source: Mesh, scale: float, name: str) -> trimesh.Trimesh:
    """Return the mesh of a source that `is_mesh`, in metres; the source stays as it is."""
    if not isinstance(source, tuple | list):
        return mesh_of(source.vertices, source.faces, scale, name)
    if len(source) != 2:
        raise MeshError(f"{name}: a mesh is a pair of vertices (V, 3) and faces (F, 3), got {len(source)}")
    vertices, faces = source
    return mesh_of(vertices, faces, scale, name)


def prepare(
    objects: Iterable[Object], *, workers: int | None = None, progress: Callable[[str], None] | None = None
) -> None:
    """Decompose objects into convex pieces, unless they are, several at a time in processes of their own.

    Args:
        objects: The objects.
        workers: Largest number of objects that are decomposed at a time; None: as many as there are cores.
        progress: Called with a line when a decomposition starts, and when it ends.

    Raises:
        MeshError: one cannot be decomposed.
    """
    waiting = [obj for obj in dict.fromkeys(objects) if not obj.is_decomposed]
    for obj, found in zip(waiting, _decompose(waiting, workers, progress), strict=True):
        vars(obj)["_decomposed"] = found


def _decompose(
    objects: Sequence[Object], workers: int | None = None, progress: Callable[[str], None] | None = None
) -> list[tuple[Body, tuple[str, ...]]]:
    """Return the body of each object, and notes on its pieces for the user."""
    cut = {obj: Cut(obj.supplied) for obj in objects if obj.supplied}
    of_settings: dict[tuple[Decomposition, str | Path | None], list[Object]] = {}
    for obj in objects:
        if not obj.supplied:
            of_settings.setdefault((obj.decomposition, obj.cache), []).append(obj)
    for (settings, cache), some in of_settings.items():
        meshes = [(obj.name, obj.mesh) for obj in some]
        cut |= zip(
            some, cut_meshes(meshes, settings, cache=_folder(cache), workers=workers, progress=progress), strict=True
        )
    found = []
    for obj in objects:
        part, notes = cut[obj], list[str]()
        if part.shortfall:
            notes.append(part.shortfall)
        if obj.beside or part.shortfall:
            notes += filter(None, [surface_note(part.pieces, obj.mesh, _folder(obj.cache, "distances"))])
        body = build_body(obj.name, part.pieces, candidates=obj.candidates, seed=obj.seed)
        found.append((body, tuple(notes)))
    return found


def _folder(cache: str | Path | None, *below: str) -> Path | None:
    """Return the folder of a cache, or the one below it."""
    if cache is None:
        return None
    return default_cache(*below) if cache == "user" else Path(cache, *below)
