"""Benchmark of scans: grasps refined on what was seen of an object, tried on the object itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from grasp_refine.core.errors import GraspRefineError, did_you_mean
from grasp_refine.core.plurals import count_text
from grasp_refine.forces.quality import CONFIDENCE
from grasp_refine.problem.example import EXAMPLE_HAND
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine_apps.bench.chart import Axis, Chart, Row
from grasp_refine_apps.bench.jobs import Job
from grasp_refine_apps.bench.report import Column, Note, Report, Table, failed_table, interval
from grasp_refine_apps.bench.scans.measure import Case, Measured, Measurement
from grasp_refine_apps.bench.success.assets import EMBEDDED_OBJECTS, HandCase, ObjectCase, find_hands, read_objects
from grasp_refine_apps.bench.success.trials import Trial

NUM_BINS = 10
"""Number of bins of the promised quality."""

VIEWS, OBJECT, BIN = "views", "object", "quality"
"""Groupings of the rows."""

INTRO = (
    "Depth pictures of each object are rendered from random sides, with the noise, holes and mask errors of a "
    "RealSense D435. Grasps are sampled on the true mesh, moved by 5 mm and turned by 10 degrees. Each way refines "
    "them knowing the scan alone, and the last one the true mesh; MuJoCo tries them on the true mesh. Unrefined hands "
    f"close as on the reconstruction. A grasp is answered where its promised quality is {CONFIDENCE:g} or more. "
    "Intervals are Wilson's, 95 %."
)


@dataclass(frozen=True)
class ScanStudy:
    """Settings of a run."""

    measurement: Measurement = field(default_factory=lambda: Measurement(Trial(DEXGRASPBENCH)))
    """Settings of each case."""
    assets: Path | None = None
    """Folder of hands and objects; None: the embedded ones."""
    hands: tuple[str, ...] = ()
    """Names of the hands; none: all of the folder, or the example's."""
    on: tuple[str, ...] = ()
    """Names of the objects; none: all of the folder, or `EMBEDDED_OBJECTS`."""
    workers: int = 1
    """Processes."""

    def jobs(self, say: Callable[[str], None]) -> list[Job]:
        """Return a job for each hand on each object.

        Raises:
            GraspRefineError: there is no such hand or object.
        """
        if self.assets is None:
            hands = [HandCase(name, name, name) for name in self.hands or (EXAMPLE_HAND,)]
            objects = [ObjectCase(name, name, 1.0) for name in self.on or EMBEDDED_OBJECTS]
        else:
            hands = _named("hand", find_hands(self.assets), self.hands, lambda hand: hand.name)
            objects = _named("object", read_objects(self.assets), self.on, lambda obj: obj.name)
        cases = [Case(hand, obj) for obj in objects for hand in hands]
        return [Job(case.name, partial(self.measurement.run, case)) for case in cases]

    def rows(self, done: Sequence[Sequence[Measured]]) -> list[Row]:
        """Return rows by number of views and way, by object, and by promised quality."""
        every = [one for case in done for one in case]
        views = sorted({one.views for one in every})
        objects = list(dict.fromkeys(one.case.object.name for one in every if one.case is not None))
        found: list[Row] = []
        for number in views:
            some = self._by_way([one for one in every if one.views == number])
            found += [{"by": VIEWS, "views": number, "label": row["way"], **row, **_share(row, some)} for row in some]
        for name in objects:
            of_object = [one for one in every if one.case is not None and one.case.object.name == name]
            found += [{"by": OBJECT, "label": name, **row} for row in self._by_way(of_object)]
        return found + _bins([one for one in every if one.way == "hypotheses"])

    def _by_way(self, every: Sequence[Measured]) -> list[Row]:
        """Return a row for each way of some results."""
        some = [[one for one in every if one.way == way] for way in self.measurement.ways]
        return [_row(of_way) for of_way in some if of_way]

    def report(self, rows: Sequence[Row], problems: Sequence[str]) -> Report:
        """Return tables by views, by promised quality and by object, and a chart of promise against truth."""
        parts: list[Note | Chart | Table] = [Note(INTRO, only=None)]
        for number in dict.fromkeys(row["views"] for row in rows if row["by"] == VIEWS):
            lines = [row for row in rows if row["by"] == VIEWS and row["views"] == number]
            title = f"{count_text(number, 'view')}, {count_text(lines[0]['grasps'], 'grasp')} by each way"
            parts.append(Table(title, COLUMNS, lines))
        if bins := [row for row in rows if row["by"] == BIN]:
            error = calibration_error(bins)
            note = f"Expected calibration error of the promised quality: {100 * error:.1f} points."
            parts += [Table("Promised quality over all hypotheses, and truth", BINS, bins), Note(note, only=None)]
            parts.append(
                Chart("Promised and true probability of holding", bins, *AXES, line=lambda row: "all hypotheses")
            )
        lines = [row for row in rows if row["by"] == OBJECT]
        parts.append(Table("By object, all views", OF_OBJECT, lines, folded=True, only="page"))
        return Report("Grasps on scans", [*parts, *failed_table(problems)])


def calibration_error(bins: Sequence[Row]) -> float:
    """Return the expected calibration error: mean distance of promise and truth over bins, by their grasps."""
    counts = np.array([row["grasps"] for row in bins])
    away = np.array([abs(row["promised"] - row["held"]) for row in bins])
    return float((counts * away).sum() / counts.sum())


def _named(kind: str, every: Sequence, names: Sequence[str], name_of: Callable) -> list:
    """Return the hands or objects of some names, in their order; all without names.

    Raises:
        GraspRefineError: there is none of a name.
    """
    known = {name_of(each): each for each in every}
    for name in names:
        if name not in known:
            raise GraspRefineError(f"no {kind} '{name}'{did_you_mean(name, known, otherwise=':')} {', '.join(known)}")
    return [known[name] for name in names] if names else list(every)


def _row(some: Sequence[Measured]) -> Row:
    """Return the numbers of some results of one way."""
    held, quality = (np.concatenate([getattr(one, name) for one in some]) for name in ("held", "quality"))
    answered = np.nan_to_num(quality) >= CONFIDENCE
    count = len(held)
    return {
        "way": some[0].way,
        "grasps": count,
        **interval("held", held),
        "answered": float(answered.mean()) if np.isfinite(quality).any() else None,
        **interval("answered_held", held[answered]),
        "points": float(np.median([one.points for one in some])),
        "completion_ms": 1e3 * float(np.mean([one.completion_s for one in some])),
        "refinement_ms": 1e3 * sum(one.refinement_s for one in some) / count,
        "troubles": sum(bool(one.trouble) for one in some),
    }


def _share(row: Row, some: Sequence[Row]) -> Row:
    """Return how far a way comes from the plain reconstruction to the true mesh."""
    held = {each["way"]: each["held"] for each in some}
    low, high = held.get("reconstruction"), held.get("mesh")
    if low is None or high is None or high <= low:
        return {"way_to_mesh": None}
    return {"way_to_mesh": (row["held"] - low) / (high - low)}


def _bins(some: Sequence[Measured]) -> list[Row]:
    """Return a row for each bin of the promised quality that has grasps."""
    if not some:
        return []
    quality, held = (np.concatenate([getattr(one, name) for one in some]) for name in ("quality", "held"))
    number = np.clip((np.nan_to_num(quality) * NUM_BINS).astype(int), 0, NUM_BINS - 1)
    found = []
    for k in np.unique(number).tolist():
        at = number == k
        label = f"{k / NUM_BINS:.1f} to {(k + 1) / NUM_BINS:.1f}"
        promised = float(np.nan_to_num(quality[at]).mean())
        found.append(
            {"by": BIN, "label": label, "grasps": int(at.sum()), "promised": promised, **interval("held", held[at])}
        )
    return found


COLUMNS = (
    Column("label", "way"),
    Column("held", "held", "%", ".1f", "higher"),
    Column("held_lower", "from", "%", ".1f", hint="lower end of the interval"),
    Column("held_upper", "to", "%", ".1f", hint="upper end of the interval"),
    Column("way_to_mesh", "of the way", "%", ".0f", hint="from the plain reconstruction to the true mesh"),
    Column("answered", "answered", "%", ".0f", "higher", hint="grasps of enough promised quality"),
    Column("answered_held", "of these held", "%", ".1f", "higher"),
    Column("answered_held_lower", "from", "%", ".1f", only="page"),
    Column("answered_held_upper", "to", "%", ".1f", only="page"),
    Column("points", "points", form=".0f", only="page", hint="median of the scans"),
    Column("completion_ms", "object", "ms", ".0f", hint="CPU time from the scan to the object"),
    Column("refinement_ms", "a grasp", "ms", ".0f", hint="CPU time of the refinement of a grasp"),
    Column("troubles", "no object", form="d", hint="scans that say too little"),
)

OF_OBJECT = (
    Column("label", "object"),
    Column("way", "way"),
    *(column for column in COLUMNS[1:] if column.key != "way_to_mesh"),
)

BINS = (
    Column("label", "promised"),
    Column("grasps", "grasps", form="d"),
    Column("promised", "mean", "%", ".1f"),
    Column("held", "held", "%", ".1f"),
    Column("held_lower", "from", "%", ".1f"),
    Column("held_upper", "to", "%", ".1f"),
)

AXES = (
    Axis("promised", "promised quality", "%", log=False),
    (Axis("held", "held on the true mesh", "%", log=False),),
)
