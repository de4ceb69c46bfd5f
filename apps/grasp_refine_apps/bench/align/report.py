"""The report of the alignment benchmark: error against time, swept settings, and tables by body, target and pair."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import floor
from typing import Any, get_args

import numpy as np

from grasp_refine.core.plurals import count_text
from grasp_refine_apps.bench.align.bodies import KINDS
from grasp_refine_apps.bench.align.stopwatch import PARTS
from grasp_refine_apps.bench.align.variants import MethodName, SolverName
from grasp_refine_apps.bench.chart import Axis, Chart, Row
from grasp_refine_apps.bench.report import Column, Note, Report, Table

METHODS: tuple[str, ...] = (*get_args(MethodName), *get_args(SolverName)[1:])
"""Order of the methods of descent and of the other solvers."""
SETTINGS = (
    "solver", "neighborhood", "coupling", "transport", "optimise", "margin", "step_size", "witness", "epsilon", "dtype",
)  # fmt: skip
"""Settings in which rows of one method may differ, in the order of a label."""
SWEPT = {"margin": "contact margin", "step_size": "step size of rotations at the start"}
"""Settings with a chart of their own when several values were run -> name on the axis."""

MIN_ERROR_M2 = 1e-14
"""Errors below this (m^2, a tenth of a micrometre) are drawn at it."""

MAX_LINES = 12
"""With more lines than this, a swept setting is shown at its best value only."""

INTRO = """A target point is marked on either of two bodies, and a solver moves one body, or both, until their witness
points lie on the targets, at the distance of the contact margin. The error is (distance of witness point a from its
target)² + (the same of b)² + (distance of the bodies − contact margin)², in square metres: 1e-6 m² is 1 mm. Each
solver returns its best iterate. "Closed-form" places a body once, with opposite
normals at the targets; "closed-form-first" is Levenberg-Marquardt, which tries that pose first when a task stalls. The
other rows show the value of a derivative. "Patch" evaluates the same poses by those of all nearly closest points that
are nearest to the targets.
"""

TIMES = """Each point is a budget. CPU time is for all targets of a pair together; finite differences and zeroth order
ran on an eighth of the targets, their time multiplied by eight. A hollow marker means none missed, or an error too
small to draw."""

RESULTS = """Targets on two faces are counted separately: there the witness points are not unique."""


def _percent(share: float) -> str:
    # Rounding must not turn one miss in ten thousand into none.
    return "100" if share == 1.0 else f"{floor(1e3 * share + 1e-6) / 10:.1f}"


def _accuracy(key: str, head: str, hint: str, **settings: str) -> Column:
    """Make a column of a share of solved tasks."""
    return Column(key, head, "%", _percent, "higher", hint, **settings)  # type: ignore[arg-type]  # only: a literal


LABEL, BUDGET = Column("label", "variant"), Column("budget_label", "budget", hint="limit of each task")

COLUMNS = (
    _accuracy("acc_1e6", "Acc@ 1e-6", "share of targets with an error below 1e-6 m² (1 mm)"),
    _accuracy("acc_1e8", "Acc@ 1e-8", "share of targets with an error below 1e-8 m² (0.1 mm)"),
    Column("d5", "D5", "m²", ".0e", "lower", "median of the error"),
    Column("d9", "D9", "m²", ".0e", "lower", "9th decile: nine of ten errors are below it"),
    _accuracy("reachable.acc_1e6", "reach\u00adable", "Acc@1e-6 of the targets known to be reachable within 0.1 mm"),
    _accuracy("unfiltered.acc_1e6", "all drawn", "Acc@1e-6 of all targets drawn, also where bodies are in the way"),
    Column("queries_mean", "queries", form=".0f", better="lower", hint="collision queries per target", only="page"),
    Column("query_us", "query", "µs", ".0f", "lower", "CPU time of a query, forward and backward"),
    Column("sampling_us", "sampling", "µs", ".0f", hint="of these, the choice of surface samples", only="page"),
    Column("cpu_s_per_pair", "CPU a pair", "s", ".2g", "lower", "CPU time per pair of bodies"),
    *(Column(f"cpu_share.{part}", part, "%", ".0f", hint="share of the CPU time", only="page") for part in PARTS),
)
"""Numbers of each row."""

PATCH = (
    _accuracy("patch.acc_1e6", "patch 1e-6", "Acc@1e-6 at the same poses, by patch"),
    _accuracy("patch.acc_1e8", "patch 1e-8", "Acc@1e-8 at the same poses, by patch"),
)
"""Accuracies by patch witness points; in a terminal they replace the accuracy on all drawn tasks."""


def report(rows: Sequence[Row], title: str) -> Report:
    """Return the report of rows as `bench align` writes them; `title` names their common settings."""
    labelled = ordered([_shown(row, label) for row, label in zip(rows, labels_of(rows), strict=True)])
    every = pooled(labelled)
    last = at_largest_budget(labelled)
    columns = _columns(every)
    parts: list[Table | Chart | Note] = [Note(INTRO), _times(every)]
    parts += [_sweep(every, key) for key in swept(every)]
    parts += _printed(labelled, title, columns)
    for kind in kinds_of(last):
        of_kind = [row for row in last if row["kind"] == kind]
        of_kind = [row for row in every if row["kind"] == kind]
        parts += [
            Table(f"Results, {kind} bodies", columns, of_kind, RESULTS, only="page"),
            _folded(f"By features of the targets, {kind} bodies", of_kind, columns, "target_class"),
            _folded(f"By pair, {kind} bodies", of_kind, columns, "pair"),
        ]
    return Report("Alignment benchmark", [part for part in parts if not isinstance(part, Table) or part.rows])


def _shown(row: Row, label: str) -> Row:
    """Add the derived numbers of a row, which are shown but not saved."""
    passes = row["forward_us"], row["backward_us"]
    return {
        **row,
        "label": label,
        "budget_label": f"{row['budget_s']:g} s" if row["budget"] is None else f"{row['budget']}",
        "query_us": None if None in passes else sum(passes),
        # Matplotlib finds no limits for a number an ulp beside a power of ten.
        "missed": None if row["acc_1e6"] is None else round(1.0 - row["acc_1e6"], 12),
    }


def _columns(rows: Sequence[Row]) -> tuple[Column, ...]:
    """Return the columns of tables: budgets where there are several, and patch witnesses where they were measured."""
    budgets = (BUDGET,) if len({row["budget_label"] for row in rows}) > 1 else ()
    if not epsilons(rows):
        return LABEL, *budgets, *COLUMNS
    return LABEL, *budgets, *(column for column in COLUMNS if column.key != "unfiltered.acc_1e6"), *PATCH


def _printed(rows: Sequence[Row], title: str, columns: Sequence[Column]) -> Iterator[Table]:
    """Yield the table of each kind for a terminal, with face-face targets on lines of their own."""
    patch = f"; patch: epsilon {epsilons(rows)}" if epsilons(rows) else ""
    for kind in kinds_of(rows):
        of_kind = [row for row in rows if row["kind"] == kind and row["pair"] == "all"]
        both = any(row["target_class"] == "all" for row in of_kind)
        lines = [
            {**row, "label": "  face-face"} if both and row["target_class"] == "face-face" else row
            for row in of_kind
            if row["target_class"] in ("all", "face-face")
        ]
        pairs = f"{kind}, {count_text(of_kind[0]['pairs'], 'pair')}"
        yield Table(f"alignment, {pairs}, {title}{patch}", columns, lines, only="terminal")


def _times(rows: Sequence[Row]) -> Chart:
    """Chart median error and misses against CPU time; with many lines each method at its best swept setting."""
    note = TIMES
    for key, name in SWEPT.items():
        if len({row["label"] for row in rows}) > MAX_LINES and key in swept(rows):
            rows = at_best(rows, key)
            note += f" Each method is shown with its best {name} only."
    least = 0.5 / max(1, *(row["targets"] for row in rows))
    return Chart(
        "Error against CPU time",
        rows,
        Axis("cpu_s_per_pair", "CPU time per pair of bodies", "s"),
        (
            Axis("d5", "median error [m²]", least=MIN_ERROR_M2, marks=(1e-6, 1e-8)),
            Axis("missed", "targets missed by more than 1 mm", "%", least=least),
        ),
        lambda row: row["label"],
        lambda row: f"{row['kind']} bodies",
        note,
    )


def _sweep(rows: Sequence[Row], key: str) -> Chart:
    """Chart hits and median error at the largest budget against a setting."""
    last = at_largest_budget(rows)
    names = dict(zip(map(id, last), labels_of(last, without=[key]), strict=True))
    values = tuple(sorted({row[key] for row in last if row[key] is not None}))
    return Chart(
        f"Results over the {SWEPT[key]}",
        [row for row in last if row[key] is not None],
        Axis(key, SWEPT[key], "m" if key == "margin" else "", steps=values),
        (
            Axis("acc_1e6", "targets met within 1 mm", "%", log=False),
            Axis("d5", "median error [m²]", least=MIN_ERROR_M2, marks=(1e-6, 1e-8)),
        ),
        lambda row: names[id(row)],
        lambda row: f"{row['kind']} bodies",
        "At the largest budget of each method; the tested values are drawn at equal steps.",
    )


def _folded(title: str, rows: Sequence[Row], columns: Sequence[Column], key: str) -> Table:
    """Make a folded table of the rows of each value of `key`."""
    shown = [row for row in rows if row[key] != "all" and (key != "pair" or row["target_class"] == "all")]
    first, *others = columns
    both = (first, Column(key, key.replace("_", " ")), *others)
    return Table(title, both, sorted(shown, key=lambda row: row[key]), only="page", folded=True)


# labels and order of rows


def name_of(row: Row) -> str:
    """First word of a row's label: the method of descent, or the other solver."""
    return row["method"] if row["solver"] == "descent" else row["solver"]


def micrometres(epsilon: float) -> str:
    """Format the epsilon of a patch witness for people."""
    return f"{1e6 * epsilon:g} µm"


def epsilons(rows: Iterable[Row]) -> str:
    """List every epsilon of a patch witness among rows; empty without any."""
    return ", ".join(map(micrometres, sorted({row["patch"]["epsilon"] for row in rows if row["patch"]})))


def labels_of(rows: Sequence[Row], without: Iterable[str] = ()) -> list[str]:
    """Return a short label for each row: its method, and the settings that differ among the rows of that method.

    A patch witness is always named, with its epsilon.

    Args:
        rows: All rows that are shown together.
        without: Settings to leave out of the labels.
    """
    keys = [key for key in SETTINGS if key not in {*without, "solver", "witness", "epsilon"}]
    varying = {}
    for name in {name_of(row) for row in rows}:
        same = [row for row in rows if name_of(row) == name]
        varying[name] = [key for key in keys if len({row[key] for row in same}) > 1]

    def label(row: Row) -> str:
        settings = [_words(key, row[key]) for key in varying[name_of(row)]]
        patch = f"patch {micrometres(row['epsilon'])}" if row["witness"] == "patch" else ""
        return " + ".join(filter(None, [name_of(row), *settings, patch]))

    return [label(row) for row in rows]


def _words(key: str, value: Any) -> str:
    """Format a setting as part of a label; empty for defaults."""
    if value is None:
        return ""
    if key == "transport":
        return "EG" if value else ""
    if key == "margin":
        return f"margin {1e3 * value:g} mm"
    if key == "step_size":
        return f"step {value:g}"
    return {"T2": "", "T1T2": "both bodies move"}.get(value, str(value))


def ordered(rows: Iterable[Row]) -> list[Row]:
    """Sort labelled rows by kind, method, settings, pair and target class, then by budget, smallest first."""

    def place(row: Row) -> tuple[Any, ...]:
        return (
            KINDS.index(row["kind"]),
            METHODS.index(name_of(row)),
            *((row[key] is not None, row[key] or 0) for key in SWEPT),
            row["label"],
            row["pair"],
            row["target_class"],
            budget(row),
        )

    return sorted(rows, key=place)


def budget(row: Row) -> tuple[float, float]:
    """Sort key that grows with the budget of a row, for rows of one variant."""
    return row["budget_s"] or 0.0, row["budget"] or 0.0


def at_largest_budget(rows: Sequence[Row]) -> list[Row]:
    """Select the labelled rows with the largest budget of each variant, kind, pair and target class."""
    best: dict[tuple[str, ...], Row] = {}
    for row in rows:
        key = tuple(row[name] for name in ("label", "kind", "pair", "target_class"))
        if key not in best or budget(row) > budget(best[key]):
            best[key] = row
    return list(best.values())


def at_best(rows: Sequence[Row], key: str) -> list[Row]:
    """Select the labelled rows of each variant at the value of `key` with the most hits at its largest budget."""
    names = dict(zip(map(id, rows), labels_of(rows, without=[key]), strict=True))
    hits: dict[str, dict[Any, list[float]]] = {}
    for row in at_largest_budget(rows):
        hits.setdefault(names[id(row)], {}).setdefault(row[key], []).append(row["acc_1e6"] or 0.0)
    best = {name: max(shares, key=lambda value: np.mean(shares[value])) for name, shares in hits.items()}
    return [row for row in rows if row[key] == best[names[id(row)]]]


def pooled(rows: Iterable[Row]) -> list[Row]:
    """Select the rows over all pairs and all target classes."""
    return [row for row in rows if row["pair"] == "all" and row["target_class"] == "all"]


def swept(rows: Sequence[Row]) -> list[str]:
    """Return the settings of `SWEPT` that have several values with one method."""

    def values(key: str, method: str) -> int:
        return len({row[key] for row in rows if name_of(row) == method} - {None})

    return [key for key in SWEPT if any(values(key, method) > 1 for method in {name_of(row) for row in rows})]


def kinds_of(rows: Iterable[Row]) -> list[str]:
    """Return the kinds among rows, convex first."""
    found = {row["kind"] for row in rows}
    return [kind for kind in KINDS if kind in found]
