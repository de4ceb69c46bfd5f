"""Folder of assets: hands, objects, and the grasps of generators.

It holds

    hands/<name>/*.urdf         a hand; settings of our hand.toml of its name are added
    hands/<name>_mjcf/*.xml     MJCF models of it, in which the grasps of generators are simulated as well
    objects/<name>.obj          meshes (or .stl, .ply, ...)
    objects.csv                 name, suggested_scale (mesh to metres), diag (of the mesh), convexity (volume / volume
                                of the hull)
    grasps/normalised/*.npz     grasps of one generator each, in our format, on objects named like the meshes or the end
                                of their names
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan
from pathlib import Path

from grasp_refine.core.errors import GraspRefineError, MeshError, quote_value
from grasp_refine.geometry.mesh import SUFFIXES
from grasp_refine.hands.files.source import list_hands, needs_urdf

EMBEDDED_OBJECTS = ("mug", "bottle", "rounded_box")
"""Embedded objects of the benchmarks that need no folder."""
EMBEDDED = "embedded/"
"""Prefix of the names of hands that come with the program."""

COLUMNS = ("name", "suggested_scale", "diag", "convexity")
"""Columns of objects.csv that are used."""
CONVEX = 0.9
"""Smallest share of the volume of its hull that a convex object fills."""
SIZES_M = (0.14, 0.18)
"""Diagonals of the bounding box between small and medium, and between medium and large objects, metres."""
SIZES = ("below 14 cm", "14 to 18 cm", "above 18 cm")
"""Classes of objects by these diagonals."""


@dataclass(frozen=True)
class HandCase:
    """A hand, and its files."""

    name: str
    """Name in tables and of `--hands`."""
    base: str
    """Name that grasp files give it."""
    hand: str
    """Field `hand` of a `ProblemSpec`."""
    urdf: Path | None = None
    """Field `urdf`."""
    mjcf: Path | None = None
    """Field `mjcf`: the model that is simulated."""


@dataclass(frozen=True)
class ObjectCase:
    """An object, and its classes."""

    name: str
    """Name in tables and of `--on`."""
    source: str
    """Field `object` of a `ProblemSpec`: a mesh file, or a primitive."""
    scale: float
    """Factor that makes it fit a hand, in metres."""
    diagonal: float = nan
    """Diagonal of its bounding box in metres at that scale; NaN: not known."""
    convexity: float = nan
    """Share of its hull's volume that it fills; NaN: not known."""

    @property
    def shape(self) -> str:
        """Class by convexity."""
        return "convex" if self.convexity >= CONVEX else "concave" if isfinite(self.convexity) else "not known"

    @property
    def size(self) -> str:
        """Class by the diagonal, at the suggested scale."""
        small, large = SIZES_M
        at = int(self.diagonal >= small) + int(self.diagonal > large)
        return SIZES[at] if isfinite(self.diagonal) else "not known"


def find_hands(assets: Path) -> list[HandCase]:
    """Return the hands of a folder, with and without MJCF models, and then the hands of the program.

    Raises:
        GraspRefineError: there is no folder of hands, or one of its folders has no hand, or several URDFs.
    """
    found: list[HandCase] = []
    folder = assets / "hands"
    if not folder.is_dir():
        raise GraspRefineError(f"{assets}: has no hands; it needs hands, objects and objects.csv")
    ours = list_hands()
    for place in sorted(path for path in folder.iterdir() if path.is_dir()):
        urdfs, models = sorted(place.glob("*.urdf")), sorted(place.glob("*.xml"))
        if len(urdfs) > 1:
            raise GraspRefineError(f"{place}: holds {len(urdfs)} URDFs, needs one: {', '.join(p.name for p in urdfs)}")
        if urdfs:
            name, urdf = place.name, urdfs[0].absolute()
            known = name in ours
            found.append(HandCase(name, name, name if known else str(urdf), urdf if known else None))
        elif not models:
            raise GraspRefineError(f"{place}: holds no hand: one .urdf file, or .xml files of the hand of that name")
    simple = {hand.name: hand for hand in found}
    for place in sorted(folder.glob("*_mjcf")):
        base = simple.get(place.name.removesuffix("_mjcf"))
        if base is None:
            raise GraspRefineError(f"{place}: its URDF is missing, in {place.name.removesuffix('_mjcf')}")
        for model in sorted(place.glob("*.xml")):
            found.append(replace(base, name=f"{place.name}/{model.stem}", mjcf=model.absolute()))
    return [*found, *(HandCase(f"{EMBEDDED}{name}", name, name) for name in ours if not needs_urdf(name))]


def read_objects(assets: Path) -> list[ObjectCase]:
    """Return the objects of objects.csv.

    Raises:
        GraspRefineError: a column, a mesh or a number is missing, and names the line; or the folder of meshes.
    """
    if not (assets / "objects").is_dir():
        raise GraspRefineError(f"{assets}: has no objects; it needs objects and objects.csv")
    path = assets / "objects.csv"
    meshes = {file.stem: file for file in sorted((assets / "objects").iterdir()) if file.suffix.lower() in SUFFIXES}
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise GraspRefineError(f"{path}: cannot be read as CSV ({error})") from None
    missing = [name for name in COLUMNS if not rows or name not in rows[0]]
    if missing:
        raise GraspRefineError(f"{path}: lacks {', '.join(missing)}; needed are the columns {', '.join(COLUMNS)}")
    return [_object_of(row, meshes, f"{path}: line {number}") for number, row in enumerate(rows, 2)]


def _object_of(row: dict[str, str], meshes: dict[str, Path], where: str) -> ObjectCase:
    name = row["name"]
    if name not in meshes:
        raise GraspRefineError(f"{where}: no mesh of object '{name}' in objects ({', '.join(SUFFIXES)})")
    numbers = []
    for column in COLUMNS[1:]:
        try:
            number = float(row[column])
        except (TypeError, ValueError):
            number = nan
        if not (isfinite(number) and number > 0):
            raise GraspRefineError(f"{where}: {column} must be a positive number, got {quote_value(row[column])}")
        numbers.append(number)
    scale, diagonal, convexity = numbers
    return ObjectCase(name, str(meshes[name].absolute()), scale, scale * diagonal, convexity)


def matching_object(name: str, objects: Sequence[ObjectCase]) -> ObjectCase:
    """Return the object that a generator calls `name`: the object `name`, or the only object whose name ends with it.

    Hyphens and underscores do not count. cube_<N>mm is a cube of that size.

    Raises:
        MeshError: there is none, or there are several.
    """
    cube = re.fullmatch(r"cube_(\d+(?:\.\d+)?)mm", name)
    if cube:
        side = float(cube[1]) / 1e3
        return ObjectCase(name, f"box:{side:g},{side:g},{side:g}", 1.0, side * 3**0.5, 1.0)

    def plain(text: str) -> str:
        return re.sub("[-_]", "", text)

    found = [thing for thing in objects if thing.name == name]
    found = found or [thing for thing in objects if plain(thing.name).endswith(plain(name))]
    if len(found) != 1:
        those = f"several are: {', '.join(thing.name for thing in found)}" if found else "none is"
        raise MeshError(f"object '{name}' of a generator must be an object of objects.csv; {those}")
    return found[0]
