"""Benchmark of success: the share of input and refined grasps that hold in simulation, and the cost of refinement."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any
from uuid import uuid4

from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.problem.input_cache import InputCache
from grasp_refine.problem.load import Loader
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.refinement.config import Config
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.registry import PROTOCOLS
from grasp_refine.scene.scene_file import list_scenes
from grasp_refine_apps.batch.page import case_entry
from grasp_refine_apps.batch.pictures import draw_cases
from grasp_refine_apps.batch.work import cache_of
from grasp_refine_apps.batch.worst import Case as Pictured
from grasp_refine_apps.bench.chart import Axis, Chart, Row, group_rows
from grasp_refine_apps.bench.jobs import Job
from grasp_refine_apps.bench.report import MISSING, SCALES, Column, Figures, Note, Only, Report, Table, failed_table
from grasp_refine_apps.bench.success.assets import SIZES
from grasp_refine_apps.bench.success.cases import SAMPLED, Axes, load_case
from grasp_refine_apps.bench.success.measure import (
    PREFERENCES,
    Measured,
    Measurement,
    Method,
    MethodName,
    file_of,
    methods_of,
)
from grasp_refine_apps.bench.success.rows import ALL, ENGINES, FAILURE, key_of, rows
from grasp_refine_apps.bench.success.trials import AnyTrial, Trial, WholeTrajectory

ARROW = " → "
"""Between the values of the methods in a cell."""

PATIENCE_S = 300.0
"""CPU time after which no further picture is begun, seconds."""

MANY = 40
"""Groups from which on their table is folded on a page, and not printed."""

INTRO = (
    "Grasps as they were given and by each method of refinement: where a cell has several values, they are of the "
    "methods, from left to right. No simulation takes part in refinement. A grasp that was refined is tried with our "
    "own pregrasp and squeeze; as given, with its own where it has them."
)

PICTURES = "As given (left) and refined (right). Commands are for the folder of results."


@dataclass(frozen=True)
class SuccessStudy:
    """Settings of a run."""

    axes: Axes = field(default_factory=Axes)
    """Hands, objects, scenes and sources of grasps."""
    methods: tuple[MethodName, ...] = ("as-given", "own-stages", "geometry-only", "closest")
    """Methods to compare; the first one is the reference."""
    starts: tuple[int, ...] = (1, 6)
    """Numbers of starts of each of `PREFERENCES`."""
    trials: tuple[AnyTrial, ...] = (Trial(PROTOCOLS["dexgraspbench"]), Trial(PROTOCOLS["strict"]))
    """Ways to try grasps."""
    perturb: bool = False
    """Whether each grasp is tried once more, perturbed."""
    shrink: bool = False
    """Whether objects on which no grasp is found are scaled until there is one."""
    width: int = Config.width
    """Largest number of grasps that are refined at once."""
    seed: int = 0
    """Seed of all random numbers."""
    threads: int | None = None
    """CPU threads of the simulation; None: all cores, or one of several processes."""
    workers: int = 1
    """Processes."""
    out: Path | None = None
    """Folder of results; a later run reads finished cases from it."""

    @property
    def measurement(self) -> Measurement:
        """Settings with which cases are measured."""
        threads = 1 if self.threads is None and self.workers > 1 else self.threads
        return Measurement(
            methods_of(self.methods, self.starts),
            self.trials,
            self.perturb,
            self.shrink,
            self.width,
            self.seed,
            threads,
            self.out,
            uuid4().hex,
        )

    def jobs(self, say: Callable[[str], None]) -> list[Job]:
        """Return a job for each case.

        Raises:
            GraspRefineError: a hand, object, scene or generator does not exist; or the only case cannot be loaded.
        """
        measurement, cases = self.measurement, self.axes.cases()
        if len(cases) == 1:
            Loader(cases[0].spec, self.seed, say, cache=cache_of(measurement.token)).problem()
        return [Job(case.name, partial(measurement.run, case), case.requested or 1.0) for case in cases]

    def rows(self, done: Sequence[Sequence[Measured]]) -> list[Row]:
        """Return the rows of all grasps and of each group by each method, as `rows.rows`."""
        return rows([case for case in done if case and len(case[0].labels["hand"])], self.trials)

    def report(self, rows: Sequence[Row], problems: Sequence[str]) -> Report:
        """Return tables by method, and of each way to group grasps; success against time; and failures."""
        columns = [column for trial in self.trials for column in trial.columns]
        every = [row for row in rows if row["by"] == ALL]
        count, methods = every[0]["grasps"], [row["refined"] for row in every]
        parts: list[Note | Chart | Table | Figures] = [Note(INTRO)]
        if len(self.starts) > 1 and set(PREFERENCES) & set(self.methods):
            parts.append(_chart(rows, columns))
        title = f"{count} grasps; held, and lost of those that held before"
        parts.append(Table(title, [METHOD, *_brief(columns)], every, only="terminal"))
        parts += _fronts(rows, columns)
        for heading, shown in (("Success", _verdicts(columns)), ("Costs", COSTS), ("Geometry of the grasps", GEOMETRY)):
            parts.append(Table(heading, [METHOD, *(c for c in shown if c.key in every[0])], every, only="page"))
        ways = [column for trial in self.trials if isinstance(trial, WholeTrajectory) for column in trial.columns]
        for by in dict.fromkeys(row["by"] for row in rows if row["by"] not in (ALL, ENGINES, FAILURE)):
            lines = _pivoted([row for row in rows if row["by"] == by], methods)
            place: Only | None = "page" if len(lines) > MANY else None
            heads = [
                Column("label", by),
                Column("grasps", "number", form="d"),
                *_group_columns(columns, ways, every[0]),
            ]
            note = f"From left to right: {', '.join(methods)}; in brackets, how many are lost of those that held first."
            parts.append(Table(f"By {by}", heads, lines, note, only=place, folded=len(lines) > MANY))
        if agreed := _pivoted([row for row in rows if row["by"] == ENGINES], methods):
            parts.append(Table("Agreement of engines", AGREEMENT, agreed, AGREEMENT_NOTE))
        parts.append(_reasons(every, columns))
        return Report("Success of grasps", [*parts, *failed_table(problems), *self._pictures(rows)])

    def _pictures(self, rows: Sequence[Row]) -> Iterator[Figures]:
        """Draw failures by reason, where there is a folder of results."""
        if self.out is None:
            return
        cases = {case.name: case for case in self.axes.cases()}
        cache = InputCache()

        def load(pictured: Pictured) -> tuple[Hand, Object]:
            problem, _ = load_case(cases[pictured.source], self.seed, cache, shrink=self.shrink)
            return problem.hand, problem.groups[0].scene.object

        failed: dict[str, list[Pictured]] = {}
        for row in rows:
            if row["by"] == FAILURE and row["starts"] is not None:
                failed.setdefault(row["label"], []).append(_pictured(row))
        for what, some in failed.items():
            pictures = draw_cases(some, self.out, load, patience_s=PATIENCE_S)
            entries = [{**case_entry(picture), "origin": "", "source": ""} for picture in pictures]
            yield Figures(f"Refined grasps that do not hold: {what}", PICTURES, entries)


def _pictured(row: Row) -> Pictured:
    """Return a failure as a case of the pictures of a batch."""
    return Pictured(
        shard=0,
        file=file_of(row["case"], Method(row["method"], row["starts"]).key),
        row=row["row"],
        hand=row["hand"],
        object=row["object"],
        scale=1.0,
        source=row["case"],
        source_row=None,
        status=row["refined"],
        measures={name: tuple(values) for name, values in row["measures"].items()},
        held=False,
        reason=row["reason"],
        look=(),
    )


# report


def _chart(rows: Sequence[Row], columns: Sequence[str]) -> Chart:
    """Chart success against CPU time of a grasp, by object; grasps that are not refined are levels."""
    points = [
        {
            "panel": row["label"],
            "line": f"{column}, {row['method'] if row['method'] in PREFERENCES else row['refined']}",
            "s": row["cpu_mean_s"],
            "success": row[key_of("success", column)],
        }
        for column in columns
        for row in rows
        if row["by"] in (ALL, "object")
    ]
    return Chart(
        "Success against CPU time",
        points,
        Axis("s", "CPU time of refining a grasp", "s"),
        (Axis("success", "grasps that hold", "%", log=False),),
        lambda row: row["line"],
        lambda row: row["panel"],
        note="From left to right: the numbers of starts. Dashed: grasps that are not refined.",
    )


def _pivoted(rows: Sequence[Row], methods: Sequence[str]) -> list[Row]:
    """Return a row for each label; each number is a list of values by method, None where a method has none."""
    found: dict[str, dict[str, Row]] = {}
    for row in rows:
        found.setdefault(row["label"], {})[row["refined"]] = row
    order = {label: number for number, label in enumerate((SAMPLED, "convex", "concave", *SIZES))}
    lines = []
    for label in sorted(found, key=lambda label: (order.get(label, len(order)), label)):
        of_method = found[label]
        keys = dict.fromkeys(key for row in of_method.values() for key in row)
        line = {key: [of_method.get(method, {}).get(key) for method in methods] for key in keys}
        for column in [key.removeprefix("success_") for key in keys if key.startswith("success_")]:
            line[f"cell_{column}"] = [line[f"{name}_{column}"] for name in ("success", "held", "num_lost")]
        lines.append({**line, "label": label, "grasps": next(iter(of_method.values()))["grasps"]})
    return lines


def _listed(unit: str, form: str) -> Callable[[Any], str]:
    """Format of the values of all methods that have one."""
    scale = SCALES.get(unit, 1)
    return lambda values: (
        ARROW.join(MISSING if value is None else f"{scale * value:{form}}" for value in values)
        if any(value is not None for value in values)
        else MISSING
    )


def _shares(cell: Sequence[Sequence[float | None]]) -> str:
    """Format shares that held, with the number of lost grasps of the last method."""
    shares, _, lost = cell
    return _listed("%", ".1f")(shares) + (f" ({lost[-1]})" if lost[-1] else "")


def _counts(cell: Sequence[Sequence[float | None]]) -> str:
    """Format numbers of grasps that held."""
    return _listed("", "d")(cell[1])


def _group_columns(columns: Sequence[str], ways: Sequence[str], row: Row) -> list[Column]:
    """Columns of tables of groups: verdicts, then some numbers on a page."""
    cells = [
        Column(key_of("cell", name), name, "" if name in ways else "%", _counts if name in ways else _shares)
        for name in columns
    ]
    numbers = [
        replace(column, form=_listed(column.unit, str(column.form)), only="page", better=None)
        for column in (*COSTS, *GEOMETRY)
        if column.key in GROUP_NUMBERS and column.key in row
    ]
    return [*cells, *numbers]


def _reasons(rows: Sequence[Row], columns: Sequence[str]) -> Table:
    """Table of the numbers of grasps by reason of failure."""
    names = dict.fromkeys(name for row in rows for column in columns for name in row[key_of("reasons", column)])
    lines: list[Row] = [{"label": "held", **{c: [row[key_of("held", c)] for row in rows] for c in columns}}]
    for name in names:
        counts = {c: [row[key_of("reasons", c)].get(name, 0) for row in rows] for c in columns}
        lines.append({"label": name, **counts})
    heads = [Column(name, name, form=_listed("", "d")) for name in columns]
    return Table("Why grasps do not hold", [Column("label", "grasps that"), *heads], lines, only="page")


METHOD = Column("refined", "refined")
HEADS = {"dexgraspbench": "dex\u00adgrasp\u00adbench", "tabletop": "table\u00adtop"}
"""Name of a verdict -> its heading in a terminal."""


def _brief(columns: Sequence[str]) -> list[Column]:
    """Columns for a terminal."""
    first = columns[0]
    return [
        *(Column(key_of("success", name), f"held, {HEADS.get(name, name)}", "%", ".1f") for name in columns),
        Column(key_of("lost", first), f"lost, {HEADS.get(first, first)}", "%", ".1f"),
        Column("cpu_mean_s", "CPU mean", "s", ".3f"),
        Column("penetration_mean_m", "pen. mean", "mm", ".3f"),
        Column("self_penetration_max_m", "self max", "mm", ".2f"),
        Column("contact_error_median_m", "gap", "mm", ".3f"),
        Column("wrench_residual_median", "resi\u00addual", form=".0e"),
        Column("moved_palm_median_m", "moved", "mm", ".1f"),
        Column("moved_palm_median_rad", "", "°", ".1f"),
        Column(key_of("auc", first), "AUC", form=".2f"),
    ]


def _fronts(rows: Sequence[Row], columns: Sequence[str]) -> Iterator[Table]:
    """Yield the tables of holding against displacement, of all grasps and of each source."""
    held = [
        column
        for name in columns
        for column in (
            Column(key_of("success", name), HEADS.get(name, name), "%", ".1f", "higher", "grasps that hold"),
            Column(key_of("num_lost", name), "lost", "", "d", "lower", "number of input grasps that held"),
        )
    ]
    for (_, label), lines in group_rows(rows, ("by", "label")).items():
        if lines[0]["by"] in (ALL, "source"):
            title = f"Front, {label}: {lines[0]['grasps']} grasps, {lines[0]['good']} good enough already"
            heads = [METHOD, *held, *(column for column in FRONT if column.key in lines[0])]
            yield Table(title, heads, lines, FRONT_NOTE)


def _verdicts(columns: Sequence[str]) -> list[Column]:
    return [
        column
        for name in columns
        for column in (
            Column(key_of("success", name), name, "%", ".1f", "higher", "grasps that hold"),
            Column(key_of("lost", name), "lost", "%", ".1f", "lower", "of the input grasps that held"),
            Column(key_of("auc", name), "AUC", "", ".3f", "higher", "of the quality against success"),
        )
    ]


COSTS = (
    Column("cpu_mean_s", "CPU", "s", ".3f", "lower", "of refining a grasp, mean"),
    Column("cpu_median_s", "median", "s", ".3f", "lower", "CPU of refining a grasp, median"),
    Column("wall_mean_s", "wall", "s", ".3f", "lower", "of refining a grasp, mean"),
    Column("wall_median_s", "median", "s", ".3f", "lower", "wall time of refining a grasp, median"),
    Column("starts_mean", "starts", "", ".2f", hint="number of starts of a grasp, mean"),
    Column("moved_palm_median_m", "palm moved", "mm", ".1f", hint="median"),
    Column("moved_palm_median_rad", "rotated", "°", ".1f", hint="the palm, median"),
    Column("moved_joints_median_rad", "joints", "°", ".1f", hint="the joint that moved most, median"),
)


def _moved(key: str, head: str, what: str, only: Only | None = None) -> tuple[Column, Column]:
    """Columns of the median and the 90th percentile of a movement."""
    return (
        Column(f"{key}_median_m", head, "mm", ".1f", "lower", f"{what}, median", only),
        Column(f"{key}_q90_m", "90 %", "mm", ".1f", "lower", f"{what}, 9 of 10 are smaller", only),
    )


FRONT_NOTE = (
    "Holding against displacement. Good inputs were good enough already: they passed the first trial, with a quality "
    f"of at least {Config.confidence:g}."
)
FRONT = (
    *_moved("displacement", "dis\u00adplace\u00adment", "of the hand's surface"),
    *_moved("moved_palm", "palm", "of the palm", "page"),
    *_moved("good_displacement", "good inputs", "of the hand's surface, good inputs alone", "page"),
    *_moved("good_moved_palm", "good, palm", "of the palm, good inputs alone"),
    Column("contacts_moved_median_m", "contacts", "mm", ".1f", "lower", "movement on the object, median", "page"),
    Column("links_kept_mean", "links kept", "%", ".0f", "higher", "contact links that stay contact links, mean"),
    Column("cpu_mean_s", "CPU", "s", ".3f", "lower", "of refining a grasp, mean"),
)
GEOMETRY = (
    Column("penetration_mean_m", "penetration", "mm", ".2f", "lower", "deepest penetration of any link, mean"),
    Column("penetration_q95_m", "p95", "mm", ".4f", "lower", "19 of 20 are smaller"),
    Column("self_penetration_max_m", "self", "mm", ".4f", "lower", "links in each other, worst"),
    Column("contact_error_median_m", "gap", "mm", ".4f", "lower", "of the worst of the links that touch, median"),
    Column("wrench_residual_median", "residual", "", ".1e", "lower", "wrench residual, median"),
    Column("wrench_residual_q75", "q75", "", ".1e", "lower", "three of four are smaller"),
    Column("quality_median", "quality", "", ".3f", "higher", "median"),
    Column("pushed_max_m", "neighbour pushed", "mm", ".1f", "lower", "the farthest"),
)
GROUP_NUMBERS = ("penetration_mean_m", "moved_palm_median_m", "moved_palm_median_rad", "cpu_mean_s", "pushed_max_m")
"""Numbers beside verdicts in tables of groups."""

AGREEMENT_NOTE = (
    "Grasps by each method that have the same verdict in both; kappa is the agreement beyond chance, and unknown where "
    "all grasps have one verdict."
)
AGREEMENT = (
    Column("label", "protocol, first and second engine"),
    Column("grasps", "number", form="d"),
    Column("share", "same verdict", "%", _listed("%", ".1f"), hint="share of the grasps"),
    Column("kappa", "kappa", "", _listed("", "z.2f"), hint="1: equal, 0: as by chance"),
    Column("first_only", "held in the first only", "", _listed("", ".0f"), hint="number of grasps"),
    Column("second_only", "held in the second only", "", _listed("", ".0f"), hint="number of grasps"),
)

# presets

OBJECTS = ("mug", "bottle", "bowl", "rounded_box", "sphere:0.03", "cylinder:0.03,0.12")
"""Objects on which hands are tried: embedded objects, and two primitives."""

ASSETS_OBJECTS = (
    *("ycb_005_tomato_soup_can", "ycb_007_tuna_fish_can", "ycb_011_banana", "ycb_013_apple", "ycb_021_bleach_cleanser"),
    *("ycb_035_power_drill", "ycb_037_scissors", "ycb_044_flat_screwdriver", "ycb_051_large_clamp"),
    *("ycb_056_tennis_ball", "ycb_061_foam_brick", "ycb_065c_cups", "ycb_077_rubiks_cube", "robosuite_bottle"),
    *("robosuite_can", "robosuite_lemon", "rdg_hammer_40", "rdg_stapler_gray_d9", "rdg_mug_gray_d7", "tm_rabbit"),
)
"""Objects of a folder of assets on which grippers are tried, names in objects.csv."""

_ONE, _SEVERAL = (replace(DEXGRASPBENCH, palm="rigid", multiccd=several) for several in (False, True))

GRIPPER_TRIALS = tuple(
    Trial(protocol.with_friction(friction), name=f"friction {friction:g}{points}")
    for friction in (0.6, 0.3)
    for protocol, points in ((_SEVERAL, ""), (_ONE, ", one point"))
)
"""Trials of grippers: several points for two convex pieces that touch, and one, at two frictions."""

_SAMPLED = Axes(generators=(SAMPLED,))

PRESETS: Mapping[str, SuccessStudy] = MappingProxyType(
    {
        "smoke": SuccessStudy(Axes(count=2), starts=(1, 2)),
        "grippers": SuccessStudy(
            replace(_SAMPLED, hands=("franka_hand",), count=4),
            methods=("as-given", "closest"),
            starts=(Config.starts,),
            trials=GRIPPER_TRIALS,
            perturb=True,
            shrink=True,
        ),
        "scenes": SuccessStudy(
            replace(_SAMPLED, spec=ProblemSpec(arm="ur5e"), hands=("allegro", "shadow"), count=32, unaware=True),
            methods=("as-given", "closest"),
            starts=(Config.starts,),
            trials=(WholeTrajectory(),),
        ),
        "assets": SuccessStudy(
            Axes(assets=Path("assets")),
            methods=("as-given", "geometry-only", "closest"),
            starts=(Config.starts,),
            trials=tuple(map(Trial, PROTOCOLS.values())),
        ),
    }
)
"""Name of an experiment -> its study."""


def completed(study: SuccessStudy) -> SuccessStudy:
    """Return the study with all scenes that come with the program, or objects for grippers, where it names none."""
    axes = study.axes
    if any(isinstance(trial, WholeTrajectory) for trial in study.trials) and not axes.scenes:
        axes = replace(axes, scenes=tuple(list_scenes()))
    if study.perturb and not axes.on:
        axes = replace(axes, on=OBJECTS if axes.assets is None else ASSETS_OBJECTS)
    return replace(study, axes=axes)
