"""Objects, scenes and regions of refined grasps in their provenance, and checks that the present ones are the same."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from grasp_refine.core.errors import GraspFileError
from grasp_refine.geometry.pieces import Piece
from grasp_refine.grasps.provenance import read_provenance
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.objects.region_spec import VERBS, is_spec
from grasp_refine.objects.seen import is_record
from grasp_refine.problem.problem import Group
from grasp_refine.results.result_files import fingerprint
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.task_file import TASK

if TYPE_CHECKING:
    import trimesh

GRID_M = 1e-9
"""Grid in metres on which coordinates are compared: far below any mesh, far above rounding."""

MESH_TOLERANCE_SHARE = 1e-5
"""Share of the diagonal by which bounds, centroid, area and volume may differ after a mesh was exported anew."""


@dataclass(frozen=True)
class RecordedScene:
    """Scene in which grasps of a file were refined."""

    file: Path
    """File of the grasps."""
    name: str
    """Name of the scene."""
    source: str
    """File of the scene, or name of one that comes with the program; empty: it was made in memory."""
    digest: str
    """Its `Environment.digest`."""

    def check(self, present: Environment | None, *, other: bool) -> None:
        """Refuse grasps that were refined in another scene than the present one, unless another one is accepted.

        Raises:
            GraspFileError: names both scenes.
        """
        if other or (present is not None and present.digest == self.digest):
            return
        now = "no scene" if present is None else f"scene '{present.name}'"
        same = present is not None and present.name == self.name
        raise GraspFileError(
            f"{self.file}: its grasps were refined in scene '{self.name}', this is {now}"
            f"{', with other bodies or poses' if same else ''}: give that one with `scene"
            f"{f'={self.source}' if self.source and not same else ''}`, `scene=none` for the object alone, or "
            "`other_object` if this one is meant"
        )


@dataclass(frozen=True)
class Recorded:
    """Records of the refinement of grasps in files."""

    files: Mapping[Path, Mapping[str, Any]]
    """File -> its provenance, empty unless it is a result file."""

    @staticmethod
    def of(files: Iterable[Path]) -> Recorded:
        """Return the records of files.

        Raises:
            GraspFileError: a result file is damaged.
        """
        return Recorded({file: read_provenance(file) for file in files})

    def other_urdf(self, path: Path, hand: Hand, *, chosen: bool) -> list[str]:
        """Return a note if grasps were refined with another URDF than the hand's.

        Raises:
            GraspFileError: they were, and this one was not `chosen` by the user, whose hand may be named as ours.
        """
        urdf = self.files.get(path, {}).get("urdf")
        recorded = urdf.get("sha256") if isinstance(urdf, dict) else None
        if not isinstance(recorded, str) or recorded == fingerprint(hand.urdf)["sha256"]:
            return []
        other = f"{path} was made with another URDF of hand '{hand.name}' than {hand.urdf}"
        if not chosen:
            raise GraspFileError(
                f"{other}: give that one with `hand` or `urdf`, or `hand='{hand.name}'` if this one is meant"
            )
        return [other]

    def _tasks(self) -> dict[Path, Mapping[str, Any]]:
        """Return the records of the tasks, by file; empty where a file has none."""
        tasks = {file: recorded.get(TASK) for file, recorded in self.files.items()}
        return {file: task if isinstance(task, Mapping) else {} for file, task in tasks.items()}

    def scene(self) -> RecordedScene | None:
        """Return the scene of the refinement; None: there was none.

        Raises:
            GraspFileError: they were refined in different scenes.
        """
        found: RecordedScene | None = None
        for file, task in self._tasks().items():
            entry = task.get("scene")
            texts = [entry.get(key) for key in ("name", "source", "sha256")] if isinstance(entry, dict) else []
            if not texts or not all(isinstance(text, str) for text in texts):
                continue
            one = RecordedScene(file, *map(str, texts))
            if found is not None and found.digest != one.digest:
                raise GraspFileError(
                    f"{found.file} was refined in scene '{found.name}', {file} in '{one.name}': give them one by one"
                )
            found = found or one
        return found

    def regions(self) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
        """Return the regions, wanted and to avoid, of the refinement, and notes on others.

        Regions that cannot be read any more, or were made in Python, are left out, and all where files differ.
        """
        found: dict[str, list[str]] | None = None
        for task in self._tasks().values():
            lists = [task.get(verb) for verb in VERBS]
            specs = {
                verb: listed if isinstance(listed, list) else [] for verb, listed in zip(VERBS, lists, strict=True)
            }
            if found not in (None, specs):
                return (
                    (),
                    (),
                    ("the files were refined with different regions, which do not count: give `touch` or `avoid`",),
                )
            found = specs
        touch, avoid = (tuple(filter(is_spec, found[verb])) if found else () for verb in VERBS)
        lost = [f"{verb} {spec}" for verb, specs in (found or {}).items() for spec in specs if not is_spec(spec)]
        notes = tuple(
            f"refined with {one}, which cannot be read and does not count: give `touch` or `avoid`" for one in lost
        )
        return touch, avoid, notes

    def scan(self, name: str) -> Mapping[str, Any] | None:
        """Return the arguments of `load_object` with which the scan of an object was read; None: it was no scan.

        Scans of several files, or arguments that differ, are left out.
        """
        found = []
        for provenance in self.files.values():
            entries = provenance.get("objects")
            for entry in entries if isinstance(entries, list) else ():
                if isinstance(entry, dict) and entry.get("name") == name and is_record(entry.get("scan")):
                    found.append(entry["scan"])
        return found[0] if found and all(record == found[0] for record in found) else None

    def check_objects(self, groups: Iterable[Group], *, other: bool) -> tuple[str, ...]:
        """Return notes on grasps that were refined on another object, or other convex pieces, than the present.

        Args:
            groups: The grasps on the present objects; pieces of objects that are not decomposed yet are not compared.
            other: Whether another object is accepted.

        Raises:
            GraspFileError: the surface of an object differs, as at another scale of the same mesh, and that is not
                accepted.
        """
        notes, present = [], {group.key: group.scene.object for group in groups}
        for file, provenance in self.files.items():
            entries = provenance.get("objects")
            for entry in entries if isinstance(entries, list) else ():
                try:
                    key, recorded = (entry["name"], entry["scale"]), {name: entry[name] for name in ("mesh", "pieces")}
                    measures, known = np.array(entry["measures_m"], dtype=np.float64).reshape(11), key in present
                except (LookupError, TypeError, ValueError, ArithmeticError):
                    continue
                if not known or recorded | (digests := _digests(present[key])) == recorded:
                    continue
                made = f"{file}: its grasps of '{entry['name']}' were refined on"
                now = present[key]
                if recorded["mesh"] == digests["mesh"]:
                    notes.append(f"{made} other convex pieces of the same mesh")
                    continue
                if np.allclose(
                    measures,
                    _measures(now.mesh),
                    rtol=0.0,
                    atol=MESH_TOLERANCE_SHARE * float(np.linalg.norm(now.mesh.extents)),
                ):
                    notes.append(f"{made} a mesh that differs from that of {now.name} no more than by rounding")
                    continue
                made += f" another mesh, of {_size(measures)}, than that of {now.name}, of {_size(_measures(now.mesh))}"
                if not other:
                    raise GraspFileError(
                        f"{made}: give that one with `object` or `objects`, in its size, or `other_object` if this one "
                        "is meant"
                    )
                notes.append(made)
        return tuple(dict.fromkeys(notes))


def object_entries(groups: Iterable[Group]) -> list[dict[str, Any]]:
    """Return entries for provenance, by name and scale: sha256 of mesh and convex pieces in metres, and measures.

    Hashes depend on the geometry that was used, not on paths, units or the order of vertices.
    """
    return [
        {
            "name": group.object,
            "scale": float(group.scale),
            **_digests(group.scene.object),
            "measures_m": _measures(group.scene.object.mesh),
            **({} if group.scene.object.record is None else {"scan": group.scene.object.record}),
        }
        for group in groups
    ]


def surface_digest(mesh: trimesh.Trimesh) -> str:
    """Return the sha256 of the oriented triangles of a mesh on the grid, independent of the order of its elements."""
    corners = _on_grid(mesh.triangles)
    # Each triangle begins with its least corner, which keeps its orientation.
    first = np.lexsort(corners.transpose(2, 0, 1)[::-1])[:, 0]
    turned = corners[np.arange(len(corners))[:, None], (first[:, None] + np.arange(3)) % 3]
    return _digest(turned.reshape(-1, 9))


def pieces_digest(pieces: Sequence[Piece]) -> str:
    """Return the sha256 of the vertices and radii of convex pieces on the grid, independent of their order."""
    digests = sorted(_digest(_on_grid(piece.vertices), _on_grid(np.array([piece.radius]))) for piece in pieces)
    return hashlib.sha256("".join(digests).encode()).hexdigest()


def _digests(obj: Object) -> dict[str, str]:
    pieces = {"pieces": pieces_digest(obj.body.pieces)} if obj.is_decomposed and not obj.rough else {}
    return {"mesh": surface_digest(obj.mesh), **pieces}


def _measures(mesh: trimesh.Trimesh) -> np.ndarray:
    """Return lengths (11,) in metres that identify meshes: bounds, centroid, roots of area and of volume."""
    return np.concatenate([mesh.bounds.ravel(), mesh.centroid, [np.sqrt(mesh.area), np.cbrt(mesh.volume)]])


def _size(measures: np.ndarray) -> str:
    return "{:.3g} x {:.3g} x {:.3g} mm".format(*(1e3 * (measures[3:6] - measures[:3])))


def _on_grid(metres: np.ndarray) -> np.ndarray:
    return np.round(np.asarray(metres, dtype=np.float64) / GRID_M).astype(np.int64)


def _digest(rows: np.ndarray, *more: np.ndarray) -> str:
    """Return the sha256 of rows of integers, independent of their order, and of further arrays."""
    ordered = rows[np.lexsort(rows.T[::-1])]
    return hashlib.sha256(
        b"".join(np.ascontiguousarray(part, dtype="<i8").tobytes() for part in (ordered, *more))
    ).hexdigest()
