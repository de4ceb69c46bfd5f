"""Cases of the evidence: each hand on each object with sampled grasps, and the grasps of each generator, as a job list.

The folder of assets holds

    hands/<name>/*.urdf         a hand; what our hand.toml of its name adds to it is used
    hands/<name>_mjcf/*.xml     MJCF models of it, in which the grasps of generators are simulated as well
    objects/<name>.obj          meshes (or .stl, .ply, ...)
    objects.csv                 name, suggested_scale (mesh to metres), diag (of the mesh), convexity (volume / that of
                                the hull)
    grasps/normalised/*.npz     grasps of one generator each, in our format, on objects named like the meshes or the end
                                of their names
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan
from pathlib import Path
from typing import TypeVar

import numpy as np

from grasp_refine.core.errors import GraspRefineError, MeshError, quote_value
from grasp_refine.core.json_files import save_text
from grasp_refine.geometry.mesh import SUFFIXES
from grasp_refine.grasps.formats.folders import object_folder
from grasp_refine.grasps.grasp_set import load_grasps, save_npz
from grasp_refine.hands.files.source import list_hands, needs_urdf
from grasp_refine.problem.spec import SAMPLE

_Value = TypeVar("_Value")

SAMPLED = "sampled"
"""Name of the grasps that are sampled, beside those of generators."""
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

JOB_KEYS = ("name", "grasps", "hand", "urdf", "mjcf", "object", "scale")
"""Columns of the job list."""


@dataclass(frozen=True)
class HandCase:
    """A hand, and its files."""

    name: str
    """Name in tables and of `--hands`."""
    base: str
    """Name that grasp files give it."""
    hand: str
    """Value of `hand` in a job."""
    urdf: Path | None = None
    """Value of `urdf` in a job."""
    mjcf: Path | None = None
    """Value of `mjcf` in a job: the model that is simulated."""


@dataclass(frozen=True)
class ObjectCase:
    """An object, and its classes."""

    name: str
    """Name in tables and of `--objects`."""
    source: str
    """Value of `object` in a job: a mesh file, or a primitive."""
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


@dataclass(frozen=True)
class EvidenceCase:
    """Grasps of one generator, of one hand on one object: a job."""

    job: str
    """Name of the job."""
    generator: str
    """Name of the grasp file, or `SAMPLED`."""
    hand: HandCase
    object: ObjectCase
    count: int
    """Number of grasps requested."""
    grasps: str
    """Grasp file, or sample:N."""
    scale: float
    """Factor on the scales of the grasps."""

    @property
    def is_sampled(self) -> bool:
        """Whether the grasps are sampled."""
        return self.generator == SAMPLED


@dataclass(frozen=True)
class Cases:
    """Choice among the hands, objects and generators of a folder of assets."""

    assets: Path
    """Folder of the assets."""
    hands: tuple[str, ...] = ()
    """Names of hands; empty: all."""
    objects: tuple[str, ...] = ()
    """Names of objects; empty: all."""
    generators: tuple[str, ...] = ()
    """Names of grasp files, and `SAMPLED`; empty: all."""
    sampled: int = 1
    """Number of sampled grasps of each hand on each object."""
    every: int = 1
    """Sampled grasps are of each hand on every n-th object, of each hand on others."""
    generated: int = 20
    """Largest number of grasps of each generator on each object, evenly from its file."""

    def write(self, out: Path) -> list[EvidenceCase]:
        """Write the chosen grasps of generators to a folder, and return all cases; sampled grasps have no file yet.

        Raises:
            GraspRefineError: something is missing or cannot be used; names it.
        """
        for name in ("hands", "objects", "objects.csv"):
            if not (self.assets / name).exists():
                raise GraspRefineError(f"{self.assets}: has no {name}; it needs hands, objects and objects.csv")
        files = sorted((self.assets / "grasps" / "normalised").glob("*.npz"))
        generators = _chosen("generators", self.generators, {SAMPLED: None, **{file.stem: file for file in files}})
        objects = read_objects(self.assets)
        hands = find_hands(self.assets / "hands")
        chosen_hands = _chosen("hands", self.hands, {hand.name: hand for hand in hands})
        chosen = _chosen("objects", self.objects, {thing.name: thing for thing in objects})
        cases: list[EvidenceCase] = []
        for generator, file in generators.items():
            if file is None:
                simple = [hand for hand in chosen_hands.values() if hand.mjcf is None]
                for number, hand in enumerate(simple):
                    things = [thing for at, thing in enumerate(chosen.values()) if (at + number) % self.every == 0]
                    cases += [self._sampled(hand, thing) for thing in things]
            else:
                cases += self._generated(generator, file, tuple(chosen_hands.values()), objects, out)
        if not cases:
            raise GraspRefineError("no grasps of these generators are of these hands and objects")
        # Hands and objects that cases share are loaded once.
        return sorted(cases, key=lambda case: (case.hand.name, case.object.name))

    def _sampled(self, hand: HandCase, thing: ObjectCase) -> EvidenceCase:
        request = f"{SAMPLE}{self.sampled}"
        job = f"{SAMPLED}/{hand.name}/{thing.name}"
        return EvidenceCase(job, SAMPLED, hand, thing, self.sampled, request, thing.scale)

    def _generated(
        self, generator: str, file: Path, hands: Sequence[HandCase], objects: Sequence[ObjectCase], out: Path
    ) -> Iterator[EvidenceCase]:
        """Yield the cases of a generator, and write the chosen grasps of each of its objects to a file.

        Raises:
            GraspRefineError: the file cannot be read.
        """
        grasps = load_grasps(file)
        for name in dict.fromkeys(grasps.object.tolist()):
            thing = matching_object(name, objects)
            if self.objects and thing.name not in self.objects:
                continue
            rows = np.flatnonzero(grasps.object == name)
            rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(self.generated, len(rows))).round().astype(int))]
            some = grasps.select(rows)
            path = out / "grasps" / generator / f"{object_folder(thing.name)}.npz"
            save_npz(path, some.arrays())
            # Some scale the mesh, others name one in metres.
            scale = thing.scale if (some.scale == 1.0).all() else 1.0
            for hand in hands:
                if hand.base == grasps.hand and not hand.name.startswith(EMBEDDED):
                    job = f"{generator}/{hand.name}/{thing.name}"
                    yield EvidenceCase(job, generator, hand, thing, len(rows), str(path.absolute()), scale)


def with_file(case: EvidenceCase, file_of: Mapping[str, Path]) -> EvidenceCase:
    """Return a case with the file of its sampled grasps, whose scale is to metres; one of a generator as it is."""
    return replace(case, grasps=str(file_of[case.job]), scale=1.0) if case.job in file_of else case


def find_hands(folder: Path) -> list[HandCase]:
    """Return the hands of a folder, with and without MJCF models, and then those that come with the program.

    Raises:
        GraspRefineError: a subfolder without a hand, or with several URDFs.
    """
    found: list[HandCase] = []
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
    """Return the object that a generator calls `name`: that of the name, or the only one whose name ends with it.

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


def save_jobs(path: Path, cases: Sequence[EvidenceCase]) -> None:
    """Write cases as a job list of `refine-grasp batch`, CSV.

    Raises:
        GraspRefineError: it cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(JOB_KEYS)
    for case in cases:
        hand, thing = case.hand, case.object
        files = (hand.hand, hand.urdf or "", hand.mjcf or "", thing.source)
        writer.writerow([case.job, case.grasps, *files, repr(case.scale)])
    save_text(path, text.getvalue())


def _chosen(option: str, wanted: Sequence[str], known: dict[str, _Value]) -> dict[str, _Value]:
    """Return the wanted entries, in the order of `known`; all where none is named.

    Raises:
        GraspRefineError: one is not known.
    """
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise GraspRefineError(f"--{option} {unknown[0]}: there are {', '.join(known)}")
    return {name: value for name, value in known.items() if not wanted or name in wanted}
