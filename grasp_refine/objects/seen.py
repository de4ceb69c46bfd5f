"""Objects that were only seen: their scan, and the solids that they may be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from grasp_refine.core.arguments import as_numbers, check_kind, is_number
from grasp_refine.core.errors import GraspRefineError, MeshError
from grasp_refine.geometry.decomposition import Decomposition
from grasp_refine.geometry.mesh import Holes, is_closed
from grasp_refine.geometry.units import Unit
from grasp_refine.scans.camera_files import as_intrinsics, as_poses, as_positions
from grasp_refine.scans.completion import above_table, complete
from grasp_refine.scans.given import given_completions
from grasp_refine.scans.hypothesis import Hypothesis
from grasp_refine.scans.reading import Sensors, cloud_of_arrays, read_scan, scan_of_cloud, scan_of_mesh
from grasp_refine.scans.scan import Scan

if TYPE_CHECKING:
    import trimesh

HYPOTHESES = 8
"""Number of solids that a scanned object may be, by default."""

MAX_HYPOTHESES = 64
"""Largest number."""


@dataclass(frozen=True, eq=False)
class Completing:
    """Completions of a scan: see `load_object`."""

    hypotheses: int = HYPOTHESES
    """Number of solids."""
    completions: str | Path | None = None
    """Folder of completions by another program."""
    table: float | Sequence[Any] | None = None
    """Height of the table that the object stands on, or a point of it and its normal."""

    def __post_init__(self) -> None:
        """Refuse arguments of other kinds.

        Raises:
            GraspRefineError: names the argument.
        """
        check_kind("hypotheses", self.hypotheses, int)
        if not 0 < self.hypotheses <= MAX_HYPOTHESES:
            raise GraspRefineError(f"`hypotheses` must be 1 to {MAX_HYPOTHESES}, got {self.hypotheses}")
        check_kind("completions", self.completions, str | Path | None)

    @property
    def plane(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Point (3,) and normal (3,) of the table."""
        if self.table is None:
            return None
        if is_number(self.table):
            return np.array([0.0, 0.0, self.table]), np.array([0.0, 0.0, 1.0])
        point, normal = as_numbers("table", self.table, 2, 3, why="a point and a normal")
        return point, normal / np.linalg.norm(normal)

    def solids(
        self, scan: Scan, *, scale: float, holes: Holes, decomposition: Decomposition, cache: Path | None, seed: int
    ) -> tuple[tuple[Hypothesis, ...], tuple[str, ...]]:
        """Return the solids that the object of a scan may be, one that stands for all first, and notes for the user.

        Raises:
            GraspRefineError: the scan cannot be completed, or completions of another program cannot be used.
        """
        if self.completions is None:
            return complete(scan, count=self.hypotheses, seed=seed, table=self.plane), ()
        folder = Path(self.completions)
        given = given_completions(folder, scale=scale, holes=holes, decomposition=decomposition, cache=cache)
        return above_table(given[0], self.plane or scan.table), given[1]


def seen_object(
    source: Path | Scan | trimesh.Trimesh | None,
    points: Any,
    normals: Any,
    sensors: Sensors,
    name: str,
    *,
    scale: float,
    unit: Unit | None,
) -> tuple[Scan, tuple[str, ...]]:
    """Return the scan of a file, of an open mesh in metres, of points in memory, or itself; and notes for the user.

    Raises:
        MeshError: it cannot be read, or a mesh is closed.
        GraspRefineError: the sensors cannot be read.
    """
    if isinstance(source, Scan):
        if sensors.known or scale != 1.0 or unit not in (None, "m"):
            raise GraspRefineError(f"{name}: a scan has its sensors and is in metres: give it alone")
        return source, ()
    if isinstance(source, Path):
        return read_scan(source, sensors, scale=scale, unit=unit)
    if source is None:
        if sensors.intrinsics is not None or sensors.mask is not None:
            raise GraspRefineError(f"{name}: these are points; intrinsics and a mask are for depth pictures")
        return scan_of_cloud(cloud_of_arrays(points, normals, name), sensors, scale=scale, unit=unit, name=name)
    if is_closed(source):
        raise MeshError(
            f"{name}: its mesh is closed, so that all of its surface is known: leave out `seen_from` and `camera`"
        )
    return scan_of_mesh(source, sensors, name)


def record_of(path: Path, sensors: Sensors, completing: Completing) -> dict[str, Any] | None:
    """Return the arguments with which `load_object` reads a scan again, as JSON; None: some are only in memory."""
    if not (sensors.mask is None or isinstance(sensors.mask, str | Path)):
        return None
    plane = completing.plane
    return {
        "source": str(path.absolute()),
        "seen_from": None if sensors.seen_from is None else as_positions(sensors.seen_from).tolist(),
        "camera": None if sensors.camera is None else as_poses(sensors.camera).tolist(),
        "intrinsics": None if sensors.intrinsics is None else as_intrinsics(sensors.intrinsics).tolist(),
        "mask": None if sensors.mask is None else str(Path(sensors.mask).absolute()),
        "hypotheses": completing.hypotheses,
        "completions": None if completing.completions is None else str(Path(completing.completions).absolute()),
        "table": None if plane is None else [part.tolist() for part in plane],
    }


def is_record(value: Any) -> bool:
    """Return whether a value of a file has the form of `record_of`."""
    return (
        isinstance(value, Mapping)
        and set(value) == {"source", *Sensors.__dataclass_fields__, *Completing.__dataclass_fields__}
        and isinstance(value["source"], str)
    )
