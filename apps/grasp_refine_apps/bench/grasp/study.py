"""The benchmark of grasps: accuracy and speed of refinement, by solver, batch size and budget."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from types import MappingProxyType

import numpy as np
import torch

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.problem.load import load_problem
from grasp_refine.problem.spec import ProblemSpec
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.status import Status
from grasp_refine_apps.bench.chart import Axis, Chart, Row
from grasp_refine_apps.bench.grasp.rows import PARTS, rows
from grasp_refine_apps.bench.grasp.runner import SetResult, SetTask
from grasp_refine_apps.bench.grasp.tasks import Disturbance, Tasks, given_nothing, given_targets
from grasp_refine_apps.bench.grasp.variants import Kind, Variant
from grasp_refine_apps.bench.jobs import Job
from grasp_refine_apps.bench.report import Column, Note, Report, Table

COUNT = 64
"""Default number of tasks with targets of each object and scale."""

SHORT = {"levenberg-marquardt": "LM"}
"""Abbreviations of solvers."""

SIZES: Mapping[str, str] = MappingProxyType(
    {"batch": "batch", "contacts": "contacts_mean", "pieces": "pieces_mean", "processes": "processes"}
)
"""Sizes in which variants may differ -> their numbers in rows."""

INTRO = """A hand is moved until its links touch an object. Given targets: real grasps were moved until every fingertip
touched exactly, these witness points are the targets, and the hand was then disturbed and must recover them. The error
of a contact is gap² + (distance of the witness point on the link from its target)² + (the same on the object)², in
square metres; a grasp counts when all its contacts are below 1e-6 m² (1 mm). Given nothing: real grasps as given should
touch where they nearly do, without penetration of the object or of links in each other.

All measures are those of a plain query of the final grasps. Times are those of whole calls, shared evenly by the grasps
in them, and means, beside the median where there are several calls. LM is Levenberg-Marquardt. CPU time goes to
kinematics; broad phase, all of a query but coal's own work; narrow phase, which is that work (of the compiled engine,
with the choice of pieces); derivative; and solver, the rest. Measuring this takes 1 to 4 % itself."""


@dataclass(frozen=True)
class GraspStudy:
    """Settings of a run."""

    variants: tuple[Variant, ...]
    """Variants to compare."""
    sources: tuple[tuple[str, tuple[ProblemSpec, ...]], ...] = ()
    """Names of the sets of grasps, and the inputs that each consists of."""
    tasks: tuple[Kind, ...] = ("targets", "nothing")
    """Tasks with or without targets."""
    count: int | None = None
    """Tasks of each object and scale; None: all real grasps, and `COUNT` with targets."""
    scenes: int | None = None
    """Number of objects and scales of each set, evenly chosen; None: all."""
    singles: int = 32
    """Largest number of tasks of a set that are run one at a time."""
    disturbance: Disturbance = field(default_factory=Disturbance)
    """Disturbance of true grasps."""
    tolerance: float = Config.tolerance
    """Loss in m^2 below which a grasp is solved."""
    seed: int = 0
    """Seed of disturbances and solvers."""
    threads: int = 1
    """Threads of torch in each process."""
    workers: int = 1
    """Processes."""

    def jobs(self, say: Callable[[str], None]) -> list[Job]:
        """Load the sets, make their tasks, and return a job for each set, kind of tasks and variant.

        Raises:
            GraspRefineError: a set cannot be used, or none has a task.
        """
        torch.set_num_threads(self.threads)
        tasks = []
        for name, specs in self.sources:
            groups = self._load(specs, say)
            for kind in self.tasks:
                found = self._tasks(name, groups, kind)
                if found:
                    tasks.append((name, kind, found))
                if len(found) < len(groups):
                    say(
                        f"{name}: {len(groups) - len(found)} of {len(groups)} objects (at their "
                        "scales) left out with targets, no grasp of theirs can be made to touch with every fingertip"
                    )
        if not tasks:
            raise GraspRefineError("no grasp can be made to touch with every fingertip: leave out targets from --tasks")
        return [task.job for task in self.set_tasks(tasks)]

    def set_tasks(self, sets: Sequence[tuple[str, Kind, tuple[Tasks, ...]]]) -> Iterator[SetTask]:
        """Yield the tasks of each variant on sets with tasks of some kind, by object and scale."""
        for name, kind, tasks in sets:
            for variant in self.variants:
                chosen = tuple(found for group in tasks if (found := group.of(variant)) is not None)
                if chosen and variant.batch == 1:
                    # Evenly from all objects.
                    each, more = divmod(self.singles, len(chosen))
                    chosen = tuple(
                        group.take(slice(each + (i < more))) for i, group in enumerate(chosen[: self.singles])
                    )
                if chosen:
                    about = variant, name, chosen[0].scene.hand.name, kind, chosen
                    yield SetTask(*about, self.seed, self.tolerance, self.threads)

    def rows(self, done: Sequence[SetResult]) -> list[Row]:
        """Return the rows of each job: the pooled row, then a row for each object."""
        return rows(done)

    def report(self, rows: Sequence[Row], problems: Sequence[str]) -> Report:
        """Return charts over the settings that differ, and tables for each kind of tasks and each set."""
        rows = [_shown(row) for row in rows]
        parts: list[Note | Chart | Table] = [Note(INTRO)]
        for task, title in TITLES.items():
            pooled = [row for row in rows if row["task"] == task and row["object"] == "all"]
            if not pooled:
                continue
            parts += _charts(pooled, task)
            for name in dict.fromkeys(row["set"] for row in pooled):
                of_set = [row for row in pooled if row["set"] == name]
                each = [row for row in rows if (row["task"], row["set"]) == (task, name) and row["object"] != "all"]
                heading = f"{name}, {max(row['grasps'] for row in of_set)} grasps, {title}"
                parts.append(Table(heading, _brief(of_set, task), of_set, only="terminal"))
                parts.append(Table(heading, [*NAMES, *_sizes(of_set), *RESULTS[task]], of_set, only="page"))
                parts.append(Table(f"{name}, costs", [*NAMES, *_sizes(of_set), *COSTS], of_set, only="page"))
                if each:
                    columns = [OBJECT, *NAMES, *_sizes(of_set), *RESULTS[task], *COSTS]
                    parts.append(Table(f"{name}, by object", columns, each, only="page", folded=True))
        stuck = _stuck(rows)
        if stuck:
            parts.append(Note("\n\n".join(stuck), "Deep starts that did not escape"))
        return Report("Refinement of grasps", parts)

    def _load(self, specs: Sequence[ProblemSpec], say: Callable[[str], None]) -> list[Tasks]:
        """Load the grasps of a set by object and scale, at most `scenes` groups."""
        problems = [load_problem(spec, seed=self.seed, on_message=say) for spec in specs]
        groups = [group for problem in problems for group in problem.groups]
        if self.scenes is not None and self.scenes < len(groups):
            groups = [groups[i] for i in np.linspace(0, len(groups) - 1, self.scenes).round().astype(int)]
        return [Tasks(one.object, one.scale, one.scene, one.index) for one in groups]

    def _tasks(self, name: str, groups: Sequence[Tasks], kind: Kind) -> tuple[Tasks, ...]:
        if kind == "nothing":
            return given_nothing(groups, self.count)
        return given_targets(name, groups, self.count or COUNT, self.disturbance, self.seed)


# report


def _shown(row: Row) -> Row:
    """Return a row with labels, and with numbers that follow from others."""
    solver, mean = SHORT.get(row["solver"], row["solver"]), round(row["batch_mean"])
    counts = {one.label: row[f"status_{one.name.lower()}"] for one in Status if one != Status.RUNNING}
    cpu_s, worst = 1e-3 * row["cpu_ms_per_grasp"], row["contact_error_median_m"]
    return {
        **row,
        "label": solver if row["derivative"] == Variant.derivative else f"{solver}, {row['derivative']}",
        "batch_label": f"{row['batch']}" if mean >= row["batch"] else f"{row['batch']} ({mean})",
        "contacts_label": "all" if row["contacts"] is None else f"{row['contacts_mean']:g}",
        "pieces_label": "all" if row["pieces"] is None else f"{row['pieces_mean']:g}",
        "processes_label": f"{row['processes']}",
        "ended": ", ".join(f"{count} {name}" for name, count in counts.items() if count),
        "deep": None if row["deep_starts"] is None else f"{row['deep_stuck']}/{row['deep_starts']}",
        "cpu_s": cpu_s,
        "step_s": cpu_s / row["iterations_mean"] if row["iterations_mean"] else None,
        "missed": None if row["acc_1e6"] is None or worst is None or not isfinite(worst) else 1.0 - row["acc_1e6"],
    }


def varied(rows: Sequence[Row]) -> list[str]:
    """Return the sizes in which rows differ."""
    return [name for name in SIZES if len({row[name] for row in rows}) > 1]


def _line(rows: Sequence[Row]) -> Callable[[Row], str]:
    """Return the function that labels the line of a row: a solver and, if there are several, its batch size."""
    several = {row["solver"] for row in rows if len({r["batch"] for r in rows if r["solver"] == row["solver"]}) > 1}
    return lambda row: f"{row['label']}, batch {row['batch']}" if row["solver"] in several else row["label"]


def _charts(rows: Sequence[Row], task: Kind) -> Iterator[Chart]:
    """Chart errors over time, with targets, where nothing but solvers differ; and costs over each size that does."""
    sizes = varied(rows)
    if task == "targets" and not set(sizes) - {"batch"}:
        yield Chart(
            "Error against CPU time, given targets",
            rows,
            Axis("cpu_s", "CPU time per grasp", "s"),
            (
                Axis("contact_error_median_m", "contact error, median", "m", least=1e-8, marks=(1e-3,)),
                Axis("missed", "off by 1 mm", "%", least=0.5 / max(row["grasps"] for row in rows)),
            ),
            _line(rows),
            lambda row: row["set"],
            "Lower and further left is better. Each point is a budget in iterations and a run of its own on the same "
            "grasps. The error is that of the worst contact of a grasp. A hollow marker stands for no miss, or for an "
            "error too small to draw.",
        )
    for name in sizes:
        second = ("grasps_per_s", "grasps per second", "") if name == "processes" else ("step_s", "a step", "s")
        y = Axis("cpu_s", "CPU time per grasp", "s"), Axis(*second)
        several = len({row["label"] for row in rows}) > 1

        def line(row: Row, several: bool = several) -> str:
            return f"{row['set']} ({row['joints']} joints)" + (f", {row['label']}" if several else "")

        yield Chart(f"Cost by {name}, {TITLES[task]}", rows, Axis(SIZES[name], name), y, line, note=NOTES.get(name, ""))
        if name == "contacts" and len({row["joints"] for row in rows}) > 1:
            yield Chart("Cost by joints", rows, Axis("joints", "joints"), y, lambda row: f"contacts: {row['contacts']}")


def _stuck(rows: Sequence[Row]) -> list[str]:
    """Describe real grasps that start deep and that some Levenberg-Marquardt run did not free."""
    found = {
        f"{row['set']}: {one['object']} {one['index']}": (
            f"{1e3 * one['penetration_before_m']:.1f} mm → {1e3 * one['penetration_after_m']:.2f} mm"
        )
        for row in rows
        if row["task"] == "nothing" and row["object"] == "all" and row["solver"] == "levenberg-marquardt"
        for one in row["deep_stuck_grasps"]
    }
    return [f"{name}, {depths}" for name, depths in found.items()]


TITLES: Mapping[Kind, str] = MappingProxyType({"targets": "given targets", "nothing": "given nothing"})
NOTES = {
    "processes": "The processes share the tasks and begin at once; where other programs run on the same cores, "
    "CPU time is more reliable than grasps per second.",
    "pieces": "The object is cut by planes, so that its surface and all distances outside of it are unchanged.",
}

OBJECT = Column("object", "object")
NAMES = (
    Column("label", "solver"),
    Column("budget", "budget", form="d"),
    Column("batch_label", "batch", hint="in brackets: mean number of grasps in a batch"),
    Column("grasps", "grasps", form="d"),
)
STEPS = Column("iterations_mean", "steps", form=".0f", better="lower")
CPU = Column("cpu_ms_per_grasp", "CPU", "ms", ".1f", "lower", "per grasp, of whole calls, mean")
WALL = Column("wall_ms_per_grasp", "wall", "ms", ".1f", "lower", "per grasp, of whole calls, mean")
ERRORS = (
    Column("contact_error_median_m", "median", "mm", ".4f", "lower", "error of the worst contact of a grasp"),
    Column("contact_error_worst_m", "worst", "mm", ".2f", "lower", "error of the worst contact of all"),
)
ACCURACY = (
    Column("acc_1e6", "Acc@ 1e-6", "%", ".1f", "higher", "grasps all of whose contacts are within 1e-6 m²"),
    Column("acc_1e8", "Acc@ 1e-8", "%", ".1f", "higher", "grasps all of whose contacts are within 1e-8 m²"),
)
DEEP = Column("deep", "deep stuck", hint="starts 10 mm deep or more: number that did not escape, of all")
BRIEF: Mapping[Kind, tuple[Column, ...]] = MappingProxyType(
    {
        "targets": (*ACCURACY, *ERRORS, STEPS, CPU, WALL),
        "nothing": (
            Column("penetration_before_mean_m", "pen. before mean", "mm", ".2f"),
            Column("penetration_after_mean_m", "pen. after mean", "mm", ".3f"),
            Column("penetration_after_share_50um", "≤.05 mm", "%", ".1f"),
            Column("self_penetration_after_worst_m", "self worst", "mm", ".2f"),
            Column("gap_median_m", "gap median", "mm", ".3f"),
            DEEP,
            STEPS,
            CPU,
            WALL,
        ),
    }
)
"""Columns for a terminal."""
PENETRATION = (
    Column("penetration_before_mean_m", "pen. before", "mm", ".3g", hint="deepest penetration of any link, mean"),
    Column("penetration_after_mean_m", "pen. after", "mm", ".3g", "lower", "mean after refinement"),
    Column("penetration_after_p95_m", "p95", "mm", ".3g", "lower", "19 of 20 are smaller"),
    Column("penetration_after_worst_m", "worst", "mm", ".3g", "lower", "the largest"),
    Column("penetration_after_share_50um", "≤ 0.05 mm", "%", ".2f", "higher", "share of grasps"),
    Column("self_penetration_before_worst_m", "self before", "mm", ".3g", hint="links in each other, worst"),
    Column("self_penetration_after_worst_m", "self after", "mm", ".3g", "lower", "worst after refinement"),
    Column("self_penetration_after_share_above_10um", "> 0.01 mm", "%", ".2f", "lower", "share of grasps"),
)
RESULTS: Mapping[Kind, tuple[Column, ...]] = MappingProxyType(
    {
        "targets": (*ACCURACY, *ERRORS, *PENETRATION),
        "nothing": (
            *PENETRATION,
            Column("gap_median_m", "gap", "mm", ".3g", "lower", "of the links that should touch, median"),
            Column("gap_p90_m", "p90", "mm", ".3g", "lower", "nine of ten are smaller"),
            Column("gap_worst_m", "worst", "mm", ".3g", "lower", "the largest"),
            DEEP,
        ),
    }
)
"""Columns of a page."""
COSTS = (
    Column("iterations_mean", "iterations", form=".1f", hint="mean"),
    Column("iterations_median", "median", form=".0f", hint="of the iterations"),
    Column("queries_mean", "queries", form=".0f", hint="narrow-phase queries per grasp, mean"),
    CPU,
    Column("cpu_ms_per_grasp_median", "median", "ms", ".3g", hint="of the CPU time, where there are several calls"),
    WALL,
    Column("solver_cpu_ms_per_grasp", "loop", "ms", ".3g", hint="CPU per grasp as counted by the solver itself"),
    *(Column(f"cpu_share.{name}", name, "%", ".0f", hint="of the CPU time") for name in PARTS),
    Column("contacts_mean", "contacts", hint="links that should touch, mean"),
    Column("joints", "joints", form="d", hint="independent joints of the hand"),
    Column("pieces_mean", "pieces", hint="convex pieces of the object, mean"),
    Column("grasps_per_s", "per s", form=".1f", hint="grasps per second of the clock, of all processes together"),
    Column("limits_violated", "limits", form="d", hint="joint values beyond their limits"),
    Column("moved_palm_median_m", "moved", "mm", ".1f", hint="the base link, median"),
    Column("moved_palm_median_rad", "turned", "°", ".1f", hint="the base link, median"),
    Column("moved_joints_median_rad", "joints", "°", ".1f", hint="the joint that moved most, median"),
    Column("ended", "ended as", hint="how the solver ended"),
)


def _sizes(rows: Sequence[Row]) -> list[Column]:
    """Columns of the sizes other than the batch in which rows differ."""
    return [Column(f"{name}_label", name) for name in varied(rows) if name != "batch"]


def _brief(rows: Sequence[Row], task: Kind) -> list[Column]:
    """Columns for a terminal; columns that differ between rows replace the least informative columns."""
    columns, sizes = list(BRIEF[task]), _sizes(rows)
    budgets = len({(row["solver"], row["budget"]) for row in rows}) > len({row["solver"] for row in rows})
    left_out = [*([WALL] if budgets or sizes else []), *(ERRORS if sizes else ())]
    columns = [column for column in columns if column not in left_out]
    if budgets:
        columns.insert(0, Column("budget", "budget", form="d"))
    if "processes" in varied(rows):
        columns.append(Column("grasps_per_s", "grasps per s", form=".1f"))
    return [NAMES[0], Column("batch_label", "batch"), *sizes, *columns]
