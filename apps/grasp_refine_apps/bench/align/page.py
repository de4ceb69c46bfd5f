"""The report of the alignment benchmark: one self-contained HTML file with charts, tables and pictures."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from grasp_refine_apps.bench.align.chart import sweep_chart, time_chart
from grasp_refine_apps.bench.align.failures import Failure, caption, picture
from grasp_refine_apps.bench.align.labels import (
    SETTINGS,
    SWEPT,
    Row,
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
from grasp_refine_apps.report.html_page import rendered


@dataclass(frozen=True)
class Column:
    """A number of each row."""

    name: str
    """Head of the column."""
    hint: str
    """Explanation of the number."""
    value: Callable[[Row], float | None]
    """The number of a row; None where it was not measured."""
    words: Callable[[float], str]
    """Format of the number."""
    best: Callable[[Iterable[float]], float] | None
    """Function that selects the best of the numbers; None: no number is best."""


@dataclass(frozen=True)
class Cell:
    """A number in a table."""

    text: str
    best: bool = False


@dataclass(frozen=True)
class Line:
    """A line of a table."""

    label: str
    budget: str
    cells: tuple[Cell, ...]
    shares: tuple[tuple[str, float, str], ...]
    """Part of the CPU time, its percentage, and its label."""


@dataclass(frozen=True)
class Table:
    """Rows to be compared with each other."""

    title: str
    columns: tuple[Column, ...]
    lines: tuple[Line, ...]


@dataclass(frozen=True)
class Figure:
    """A failure with its picture."""

    head: str
    caption: str
    image: str
    """The picture as base64."""


def _percent(value: float) -> str:
    # Rounding must not turn one miss in ten thousand into none.
    return "100 %" if value == 1.0 else f"{np.floor(1e4 * value + 1e-6) / 100:.2f} %"


def _area(value: float) -> str:
    return f"{value:.1g}" if value == 0 or value >= 1 else f"{value:.1e}".replace("e-0", "e-")


def _seconds(value: float) -> str:
    return f"{value:.3g}" if value < 100 else f"{value:.0f}"


def _of(*path: str) -> Callable[[Row], float | None]:
    """Return a function that reads the number at `path` of a row."""

    def value(row: Row) -> float | None:
        found: Any = row
        for key in path:
            found = found.get(key) if isinstance(found, dict) else None
        return None if found is None or not np.isfinite(found) else float(found)

    return value


def _query_us(row: Row) -> float | None:
    """Time of a forward and a backward pass."""
    forward, backward = (_of(name)(row) for name in ("forward_us", "backward_us"))
    return None if forward is None or backward is None else forward + backward


ACC_MILLIMETRE, ACC_TENTH = "Acc@1e-6", "Acc@1e-8"
PATCH = (
    Column("patch 1e-6", f"{ACC_MILLIMETRE} at the same poses, by patch", _of("patch", "acc_1e6"), _percent, max),
    Column("patch 1e-8", f"{ACC_TENTH} at the same poses, by patch", _of("patch", "acc_1e8"), _percent, max),
    Column("patch D9 [m²]", "9th decile of the error at the same poses, by patch", _of("patch", "d9"), _area, min),
)
"""Columns by patch witness points; shown where these were measured."""
COLUMNS = (
    Column(ACC_MILLIMETRE, "share of targets with an error below 1e-6 m² (1 mm)", _of("acc_1e6"), _percent, max),
    Column(ACC_TENTH, "share of targets with an error below 1e-8 m² (0.1 mm)", _of("acc_1e8"), _percent, max),
    Column("D5 [m²]", "median of the error", _of("d5"), _area, min),
    Column("D9 [m²]", "9th decile: nine of ten errors are below it", _of("d9"), _area, min),
    Column(
        "reachable",
        f"{ACC_MILLIMETRE} of the targets known to be reachable",
        _of("reachable", "acc_1e6"),
        _percent,
        max,
    ),
    Column("unfiltered", f"{ACC_MILLIMETRE} of all targets drawn", _of("unfiltered", "acc_1e6"), _percent, max),
    Column("last", f"{ACC_MILLIMETRE} of the last iterates, not the best", _of("last", "acc_1e6"), _percent, max),
    Column("queries", "collision queries per target, mean", _of("queries_mean"), lambda v: f"{v:.0f}", min),
    Column("query µs", "CPU microseconds of a query, forward and backward", _query_us, lambda v: f"{v:.0f}", min),
    Column("sampling µs", "of these, the choice of surface samples", _of("sampling_us"), lambda v: f"{v:.0f}", None),
    Column("CPU s", "CPU seconds per pair of bodies", _of("cpu_s_per_pair"), _seconds, min),
)


def page(document: dict[str, Any], failures: Sequence[Failure]) -> str:
    """Render the report of a run of `bench align` as HTML; equal input gives equal text.

    document: The JSON document of the benchmark.
        failures: Missed tasks, for the pictures at the end.
        failures: Tasks that were missed, for the pictures at the end.
    """
    names = {id(row): label for row, label in zip(document["rows"], labels_of(document["rows"]), strict=True)}

    def label(row: Row) -> str:
        return names[id(row)]

    rows = ordered(document["rows"], label)
    every, last = pooled(rows), at_largest_budget(rows, [label(row) for row in rows])
    chart = time_chart(every)
    return rendered(
        __package__,
        document=document,
        facts=_facts(document, every),
        findings=_findings(pooled(last), label),
        chart=chart,
        sweeps=[(SWEPT[key], sweep_chart(every, key)) for key in swept(every)],
        tables=[_table(kind, [row for row in pooled(last) if row["kind"] == kind], label) for kind in kinds_of(last)],
        budgets=_budgets(every, pooled(last), label),
        classes=_matrix(last, label),
        class_tables=_split(last, "target_class", label, pair="all"),
        pair_tables=_split(last, "pair", label, target_class="all"),
        figures=[_figure(failure) for failure in failures],
        settings=_settings(every, label),
        machine=_flat(document.get("machine")),
        versions=_flat(document.get("versions")),
        config=_flat(document.get("config")),
        columns=COLUMNS,
        shares=PARTS,
    )


def _facts(document: dict[str, Any], every: Sequence[Row]) -> dict[str, Any]:
    """Numbers for the first paragraph."""
    counts = []
    for kind in kinds_of(every):
        most = max((row for row in every if row["kind"] == kind), key=lambda row: row.get("targets") or 0)
        targets, pairs = most.get("targets"), most.get("pairs")
        if targets is not None and pairs is not None:
            counts.append(f"{targets} targets on {pairs} pairs of {kind} bodies")
    margins = sorted({row["margin"] for row in every if row.get("margin") is not None})
    solvers = {row.get("solver") or "descent" for row in every}
    both = any(row.get("optimise") == "T1T2" for row in every)
    return {
        "descent": "descent" in solvers,
        "least_squares": "levenberg-marquardt" in solvers,
        "patch": epsilons(every),
        "moves": "one or both bodies" if both else "body b",
        "counts": counts,
        "margin": ", ".join(f"{1e3 * margin:g}" for margin in margins) + " mm" if margins else "",
        "cpu": _duration(document.get("cpu_s")),
        "wall": _duration(document.get("wall_s")),
    }


def _duration(seconds: float | None) -> str:
    if seconds is None:
        return ""
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def _findings(rows: Sequence[Row], label: Callable[[Row], str]) -> list[str]:
    """Describe, for each kind, the variant with the most hits and the runner-up."""
    found = []
    for kind in kinds_of(rows):
        mine = [row for row in rows if row["kind"] == kind and _of("acc_1e6")(row) is not None]
        mine.sort(key=lambda row: -row["acc_1e6"])
        if len(mine) < 2:
            continue
        if _percent(mine[0]["acc_1e6"]) == _percent(mine[1]["acc_1e6"]):
            continue
        first, second = (f"{label(row)} ({_percent(row['acc_1e6'])})" for row in mine[:2])
        found.append(f"On {kind} bodies, {first} met the most targets, before {second}.")
    return found


def _table(title: str, rows: Sequence[Row], label: Callable[[Row], str], columns: Sequence[Column] = COLUMNS) -> Table:
    """Make a table with its best numbers marked: all that look equal, unless the whole column does."""
    if any(row.get("patch") for row in rows):
        columns = (*columns, *PATCH)
    best = []
    for column in columns:
        values = [value for row in rows if (value := column.value(row)) is not None]
        several = len({column.words(value) for value in values}) > 1
        best.append(column.words(column.best(values)) if several and column.best is not None else None)
    lines = []
    for row in rows:
        numbers = [column.value(row) for column in columns]
        cells = [
            Cell("–") if value is None else Cell(column.words(value), column.words(value) == top)
            for value, column, top in zip(numbers, columns, best, strict=True)
        ]
        lines.append(Line(label(row), _budget(row), tuple(cells), _shares(row)))
    return Table(title, tuple(columns), tuple(lines))


def _budget(row: Row) -> str:
    """Format the budget of a task."""
    if row.get("budget_s") is not None:
        return f"{row['budget_s']:g} CPU s"
    return f"{row['budget']:g} iterations" if row.get("budget") is not None else "–"


def _shares(row: Row) -> tuple[tuple[str, float, str], ...]:
    """Measured parts of the CPU time."""
    parts = [(name, _of("cpu_share", name)(row)) for name in PARTS]
    return tuple((name, round(100 * part, 2), f"{name} {100 * part:.0f} %") for name, part in parts if part)


def _budgets(every: Sequence[Row], last: Sequence[Row], label: Callable[[Row], str]) -> list[Table]:
    """Make tables of all budgets, if there are several."""
    if len(every) == len(last):
        return []
    return [_table(kind, [row for row in every if row["kind"] == kind], label) for kind in kinds_of(every)]


def _split(rows: Sequence[Row], key: str, label: Callable[[Row], str], **fixed: str) -> list[tuple[str, list[Table]]]:
    """Return each value of `key` but "all" with its tables, one for each kind, among rows with the `fixed` values."""
    mine = [row for row in rows if row[key] != "all" and all(row[name] == value for name, value in fixed.items())]
    found: dict[str, list[Table]] = {}
    for value in sorted({row[key] for row in mine}, key=_class_order):
        here = [row for row in mine if row[key] == value]
        found[value] = [_table(kind, [row for row in here if row["kind"] == kind], label) for kind in kinds_of(here)]
    return list(found.items())


def _class_order(name: str) -> tuple[int, str]:
    return (CLASSES.index(name) if name in CLASSES else len(CLASSES)), name


def _matrix(rows: Sequence[Row], label: Callable[[Row], str]) -> list[Table]:
    """Make a table of hits for each kind, a line for each variant and a column for each target class."""
    mine = [row for row in rows if row["pair"] == "all" and row["target_class"] != "all"]
    tables = []
    for kind in kinds_of(mine):
        here = [row for row in mine if row["kind"] == kind]
        found: dict[str, dict[str, Row]] = {}
        for row in here:
            found.setdefault(label(row), {})[row["target_class"]] = row
        columns = [
            Column(name, f"{ACC_MILLIMETRE} of {name} targets (body a, body b)", _of(name, "acc_1e6"), _percent, max)
            for name in sorted({row["target_class"] for row in here}, key=_class_order)
        ]
        lines = [{**classes, "label": name} for name, classes in found.items()]
        tables.append(_table(kind, lines, lambda line: line["label"], columns))
    return tables


def _figure(failure: Failure) -> Figure:
    head = f"{failure.method}, {failure.kind}, {failure.target_class} target"
    image = base64.b64encode(picture(failure)).decode("ascii")
    return Figure(head, caption(failure), image)


def _settings(rows: Sequence[Row], label: Callable[[Row], str]) -> Table:
    """Make a table of all settings of each variant."""
    columns = [Column(key.replace("_", " "), "", _of(key), str, None) for key in SETTINGS]
    lines: dict[str, Line] = {}
    for row in rows:
        cells = tuple(Cell(_setting(key, row.get(key))) for key in SETTINGS)
        lines.setdefault(label(row), Line(label(row), "", cells, ()))
    return Table("", tuple(columns), tuple(lines.values()))


def _setting(key: str, value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if key == "epsilon":
        return micrometres(value)
    return f"{1e3 * value:g} mm" if key == "margin" else f"{value:g}" if isinstance(value, float) else str(value)


def _flat(value: Any, path: str = "") -> list[tuple[str, str]]:
    """Flatten nested settings into a list of dotted names and values."""
    if isinstance(value, dict):
        return [line for key, part in value.items() for line in _flat(part, f"{path}.{key}" if path else str(key))]
    if value is None and not path:
        return []
    shown = ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
    return [(path, shown if value is not None else "none")]
