"""The report of the alignment benchmark: error against time, swept settings, and tables by body, target and pair."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import floor

from grasp_refine_apps.bench.align.labels import (
    SETTINGS,
    SWEPT,
    at_best,
    at_largest_budget,
    epsilons,
    kinds_of,
    labels_of,
    micrometres,
    ordered,
    pooled,
    swept,
)
from grasp_refine_apps.bench.align.stopwatch import PARTS
from grasp_refine_apps.bench.align.tasks import CLASSES
from grasp_refine_apps.bench.chart import Axis, Chart, Row
from grasp_refine_apps.bench.report import Column, Note, Report, Table

MIN_ERROR_M2 = 1e-14
"""Errors below this (m^2, a tenth of a micrometre) are drawn at it."""

MAX_LINES = 12
"""With more lines than this, a swept setting is shown at its best value only."""

INTRO = """Two rigid bodies have one pair of witness points: the points where they are closest, or deepest inside each
other. In each task a target point is marked on either body, and a solver moves one body, or both, until the witness
points lie on the two targets, at the distance of the contact margin. The methods differ in how they differentiate the
witness points with respect to the pose. The error is (distance of witness point a from its target)² + (the same of
b)² + (distance of the bodies − contact margin)², in square metres: 1e-6 m² is 1 mm, 1e-8 m² is 0.1 mm. Of each task the
best iterate counts; "last" is the result of the last one.

Gradient descent uses up its budget. Levenberg-Marquardt only keeps steps that lower the error and ends a task that is
solved, so its budget is the most that a task may take, and "last" is its best. "Patch" is another way to evaluate the
same poses, meant for targets on two faces: of all points that are within epsilon of being the closest, those nearest to
the targets.
"""

TIMES = """Lower and further left is better. Each point is a budget, so a line shows the benefit of more computing time.
CPU time is for all targets of a pair together; pairs go through the computation many at a time, and methods with many
queries per iteration (finite differences, zeroth order) ran on an eighth of the targets, their time multiplied by
eight. A hollow marker means none missed, or an error too small to draw."""

RESULTS = """At the largest budget of each variant. Targets on two faces are counted separately: there the witness
points are not unique."""


def _percent(share: float) -> str:
    # Rounding must not turn one miss in ten thousand into none.
    return "100" if share == 1.0 else f"{floor(1e3 * share + 1e-6) / 10:.1f}"


def _area(value: float) -> str:
    return f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e+")


def _accuracy(key: str, head: str, hint: str, **settings: str) -> Column:
    """Make a column of a share of solved tasks."""
    return Column(key, head, "%", _percent, "higher", hint, **settings)  # type: ignore[arg-type]  # only: a literal


LABEL, BUDGET = Column("label", "variant"), Column("budget_label", "budget", hint="limit of each task")

COLUMNS = (
    _accuracy("acc_1e6", "Acc@ 1e-6", "share of targets with an error below 1e-6 m² (1 mm)"),
    _accuracy("acc_1e8", "Acc@ 1e-8", "share of targets with an error below 1e-8 m² (0.1 mm)"),
    Column("d5", "D5", "m²", _area, "lower", "median of the error"),
    Column("d9", "D9", "m²", _area, "lower", "9th decile: nine of ten errors are below it"),
    _accuracy("reachable.acc_1e6", "reach\u00adable", "Acc@1e-6 of the targets known to be reachable within 0.1 mm"),
    _accuracy("unfiltered.acc_1e6", "all drawn", "Acc@1e-6 of all targets drawn, also where bodies are in the way"),
    _accuracy("last.acc_1e6", "last", "Acc@1e-6 of the last iterates, not the best"),
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
"""Accuracies by patch witness points; in a terminal they replace that of all drawn tasks."""


def report(rows: Sequence[Row], title: str) -> Report:
    """Return the report of rows as `bench align` writes them; `title` names what is common to them."""
    labelled = ordered([_shown(row, label) for row, label in zip(rows, labels_of(rows), strict=True)])
    every = pooled(labelled)
    last = at_largest_budget(labelled)
    columns = _columns(every)
    parts: list[Table | Chart | Note] = [Note(INTRO), *_findings(pooled(last)), _times(every)]
    parts += [_sweep(every, key) for key in swept(every)]
    parts += _printed(labelled, title, columns)
    for kind in kinds_of(last):
        its = [row for row in last if row["kind"] == kind]
        parts += [
            Table(f"Results, {kind} bodies", columns, pooled(its), RESULTS, only="page"),
            _matrix(f"Acc@1e-6 by features of the targets, {kind} bodies", its),
            _folded(f"All budgets, {kind} bodies", [row for row in every if row["kind"] == kind], columns),
            _folded(f"By features of the targets, {kind} bodies", its, columns, "target_class"),
            _folded(f"By pair, {kind} bodies", its, columns, "pair"),
        ]
    parts.append(_settings(every))
    return Report("Alignment benchmark", [part for part in parts if not isinstance(part, Table) or part.rows])


def _shown(row: Row, label: str) -> Row:
    """Add to a row what is shown, but not saved."""
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
        its = [row for row in rows if row["kind"] == kind and row["pair"] == "all"]
        both = any(row["target_class"] == "all" for row in its)
        lines = [
            {**row, "label": "  face-face"} if both and row["target_class"] == "face-face" else row
            for row in its
            if row["target_class"] in ("all", "face-face")
        ]
        pairs = f"{kind}, {its[0]['pairs']} pair{'s' if its[0]['pairs'] != 1 else ''}"
        yield Table(f"alignment, {pairs}, {title}{patch}", columns, lines, only="terminal")


def _findings(rows: Sequence[Row]) -> Iterator[Note]:
    """Yield, for each kind, the variant with the most hits and the runner-up."""
    for kind in kinds_of(rows):
        measured = [row for row in rows if row["kind"] == kind and row["targets"]]
        best = sorted(measured, key=lambda row: -row["acc_1e6"])[:2]
        if len(best) == 2 and best[0]["acc_1e6"] > best[1]["acc_1e6"]:
            first, second = (f"{row['label']} ({_percent(row['acc_1e6'])} %)" for row in best)
            yield Note(f"On {kind} bodies, {first} met the most targets, before {second}.")


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


def _matrix(title: str, rows: Sequence[Row]) -> Table:
    """Make a table of hits: a line for each variant, a column for each class of targets."""
    found: dict[str, Row] = {}
    for row in rows:
        if row["pair"] == "all" and row["target_class"] != "all":
            line = found.setdefault(row["label"], {"label": row["label"], **dict.fromkeys(CLASSES)})
            line[row["target_class"]] = row["acc_1e6"]
    measured = [name for name in CLASSES if any(line[name] is not None for line in found.values())]
    columns = [_accuracy(name, name, f"Acc@1e-6 of {name} targets (body a, body b)") for name in measured]
    return Table(title, (LABEL, *columns), list(found.values()), only="page")


def _folded(title: str, rows: Sequence[Row], columns: Sequence[Column], key: str = "") -> Table:
    """Make a folded table of the pooled rows, or of those of each value of `key`."""
    shown = [row for row in rows if row[key] != "all"] if key else pooled(rows)
    if key == "pair":
        shown = [row for row in shown if row["target_class"] == "all"]
    shown = sorted(shown, key=lambda row: row[key]) if key else shown
    first, *others = columns
    both = (first, Column(key, key.replace("_", " ")), *others) if key else columns
    return Table(title, both, shown, only="page", folded=True)


def _settings(rows: Sequence[Row]) -> Table:
    """Make a table of all settings of each variant."""

    def text(key: str) -> Column:
        forms = {"epsilon": micrometres, "margin": lambda value: f"{1e3 * value:g} mm"}
        return Column(key, key.replace("_", " "), form=forms.get(key, str))

    lines = {row["label"]: row for row in rows}
    return Table(
        "Settings of every variant", (LABEL, *map(text, SETTINGS)), list(lines.values()), only="page", folded=True
    )
