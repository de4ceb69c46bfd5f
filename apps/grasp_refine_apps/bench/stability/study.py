"""The benchmark of stability: wrong answers of witness queries and derivatives, by body, size, state and method."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from textwrap import wrap
from types import MappingProxyType
from typing import Any

from grasp_refine.core.plurals import count_text
from grasp_refine_apps.bench.chart import Row, group_rows
from grasp_refine_apps.bench.jobs import Job, Progress
from grasp_refine_apps.bench.report import Column, Note, Only, Report, Table
from grasp_refine_apps.bench.stability.cases import DTYPES, ENGINES, KINDS, METHODS, NEIGHBORHOODS, STATES, Task
from grasp_refine_apps.bench.stability.derivative import derivative_cells
from grasp_refine_apps.bench.stability.forward import forward_cells
from grasp_refine_apps.bench.stability.rows import (
    FAULT_LABELS,
    WRONG,
    Cell,
    error_of,
    of_measure,
    total,
    worst,
)

ORDER: Mapping[str, tuple[Any, ...]] = MappingProxyType(
    {
        "kind": KINDS,
        "state": STATES,
        "dtype": DTYPES,
        "engine": ENGINES,
        "method": METHODS,
        "neighborhood": (None, *NEIGHBORHOODS),
    }
)
"""Key of a row -> its values in display order; values of other keys are sorted."""

PRINTED_CELLS, LISTED_CELLS = (5, 2), (40, 10)
"""Largest number of printed cells, and of cells on a page: wrong cells, or the nearest cells of each precision."""

MAX_REASONS = 20
"""Largest number of different reasons of refusal that are listed."""

LINE_CHARACTERS = 78
"""Characters of a line of a command, which continues after a backslash."""

INTRO = """Bodies of many kinds and sizes are placed in many states, and queried for their signed distance, their
witness points and the derivative of these. Distances are compared with those in closed form, or of the hull of all
differences of vertices; `judging` and `derivative` have the tolerances. Collapsed are answers that are right within the
tolerance, but whose sign or status is not the true one: this is counted and is not a fault."""


@dataclass(frozen=True)
class StabilityStudy:
    """Settings of a run."""

    tasks: tuple[Task, ...]
    """Bodies, states and settings of queries."""
    seed: int = 0
    """Seed of bodies and poses."""
    workers: int = 1
    """Processes."""

    def jobs(self, say: Callable[[str], None]) -> list[Job]:
        """Return a job for each task; many pieces take longest."""
        return [
            Job(f"{one.kind}, {length(one.diagonal)}", partial(cells, one), 4.0 if one.kind == "concave40" else 1.0)
            for one in self.tasks
        ]

    def rows(self, done: Sequence[Sequence[Cell]]) -> list[Row]:
        """Return a row for each cell."""
        return [cell.row() for cells in done for cell in cells]

    def report(self, rows: Sequence[Row], problems: Sequence[str]) -> Report:
        """Return counts by body, size, state and method, and the cells that are wrong or nearest to it."""
        forward, derivative = of_measure(rows, "forward"), of_measure(rows, "derivative")
        lines = [*_worst_lines(rows, self.seed), *summary(rows, len(problems))]
        parts: list[Note | Table] = [
            Note(INTRO),
            *_counts(forward, "wrong distances and points; errors are over their tolerance", "kind", FORWARD),
            *_counts(derivative, "wrong derivatives; errors are over their tolerance", "method", DERIVATIVE),
            Note("\n".join(lines), "Summary", only=None, verbatim=True),
            *_lists(rows, self.seed),
        ]
        failed = bool(problems) or total(rows)["wrong"] > 0
        return Report("Stability of witness queries", parts, failed=failed)


def cells(task: Task, progress: Progress) -> list[Cell]:
    """Check all cells of a task, in this process."""
    found: list[Cell] = []
    both = (forward_cells, task.forwards), (derivative_cells, task.derivatives)
    checks = [check for check, ways in both if ways]
    for part, check in enumerate(checks):
        for cell in check(task):
            found.append(cell)
            progress((part + (1 + task.states.index(cell.state)) / len(task.states)) / len(checks))
    return found


# counts


def _error(value: float) -> str:
    return "0" if value == 0 else f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e+")


QUERIES = Column("queries", "quer\u00adies", form="d")
FORWARD = (
    QUERIES,
    Column("refused", "re\u00adfused", form="d"),
    Column("failed", "no ans.", form="d"),
    Column("not_finite", "not fin.", form="d"),
    Column("wrong_distance", "bad dist.", form="d"),
    Column("wrong_sign", "bad sign", form="d"),
    Column("wrong_points", "bad pts.", form="d"),
    Column("points_compared", "points judged", form="d"),
    Column("collapsed", "col\u00adlaps.", form="d"),
    Column("error_max", "dist. err.", form=_error),
    Column("points_error_max", "pts. err.", form=_error),
)
"""Columns on queries."""
DERIVATIVE = (
    QUERIES,
    Column("refused", "re\u00adfused", form="d"),
    Column("failed", "no answer", form="d"),
    Column("derivative_not_finite", "not finite", form="d"),
    Column("derivative_unbounded", "un\u00adbounded", form="d"),
    Column("derivative_wrong_sign", "wrong", form="d"),
    Column("derivative_unscaled", "not scaled", form="d"),
    Column("derivative_error_max", "worst error", form=_error),
)
"""Columns on derivatives."""


def _counts(rows: Sequence[Row], title: str, first: str, columns: Sequence[Column]) -> Iterator[Table]:
    """Make tables with a line for each value of a key, for each state and for all; on a page for each size, too."""
    for key in (first, "state", "diagonal") if rows else ():
        groups = group_rows(rows, (key,))
        lines = [{"name": words(key, value), **total(groups[value,])} for value in ordered(key, (r[key] for r in rows))]
        lines += [{"name": "all", **total(rows)}] if key == "state" else []
        place: Only | None = "page" if key == "diagonal" else None
        yield Table(f"{title}, by {key}", [Column("name", key), *columns], lines, only=place)


def summary(rows: Sequence[Row], crashes: int) -> Iterator[str]:
    """Yield the numbers of queries and of faults in a line; one more of MuJoCo."""
    found = total(rows)
    asked = [
        f"{total(measured)['queries']} {name}"
        for measured, name in (
            (of_measure(rows, "forward"), "queries"),
            (of_measure(rows, "derivative"), "derivatives"),
        )
        if measured
    ]
    counts = (found["collapsed"], "collapsed"), (found["refused"], "refused"), (crashes, "crashed")
    wrong = count_text(found["wrong"], "fault")
    if found["mujoco_queries"]:
        yield f"MuJoCo, at {found['mujoco_queries']} of the queries: {found['mujoco_wrong']} wrong"
    parts = [wrong, *(f"{count} {name}" for count, name in counts if count)]
    yield f"{found['cells']} cells, {' and '.join(asked)}: {', '.join(parts)}"


def _worst_lines(rows: Sequence[Row], seed: int) -> Iterator[str]:
    """Yield the wrong cells, or else the cells nearest to it, each with the command that repeats it."""
    shown = worst(rows, *PRINTED_CELLS)
    if shown:
        yield "wrong cells, and the commands that repeat them:" if faults(shown[0]) else "nearest to being wrong:"
    for row in shown:
        error = error_of(row)
        what = [faults(row), row["dtype"], "" if error is None else f"error {_error(error)} of its tolerance"]
        yield f"- {', '.join(filter(None, what))}"
        command = again(row, seed)
        lines = wrap(command, LINE_CHARACTERS, initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False)
        yield " \\\n".join(lines)
    if shown:
        yield ""


# lists


def _lists(rows: Sequence[Row], seed: int) -> Iterator[Table]:
    """Make tables of the worst cells, of refusals and of MuJoCo's answers."""
    keys = ("kind", "diagonal", "state", "dtype", "batch", "engine", "translation", "method", "neighborhood")
    listed = [
        {
            "cell": ", ".join(words(key, row[key]) for key in keys if row[key] is not None),
            "wrong": "; ".join(filter(None, [faults(row), row["where"]])),
            "error": error_of(row),
            "command": again(row, seed),
        }
        for row in worst(rows, *LISTED_CELLS)
    ]
    if listed:
        columns = [Column(key, key) for key in ("cell", "wrong")]
        columns += [Column("error", "error", form=_error), Column("command", "command that repeats it")]
        yield Table("Wrong cells, or those nearest to it", columns, listed, only="page")
    reasons = group_rows((row for row in rows if row["refused"]), ("refusal",))
    refusals = [
        {"reason": str(why or "no reason"), "queries": total(group)["refused"], "bodies": _bodies(group)}
        for (why,), group in [*reasons.items()][:MAX_REASONS]
    ]
    if refusals:
        columns = [Column("reason", "reason"), Column("queries", "queries", form="d"), Column("bodies", "bodies")]
        yield Table("Refusals", columns, refusals, only="page")
    by_kind = group_rows((row for row in rows if row["mujoco_queries"]), ("kind",))
    asked = [{"kind": kind, **total(group)} for (kind,), group in by_kind.items()]
    if asked:
        columns = [Column("kind", "bodies"), Column("mujoco_queries", "queries", form="d")]
        columns += [Column("mujoco_wrong", "wrong", form="d")]
        yield Table("MuJoCo in comparison", columns, asked, MUJOCO, only="page")


MUJOCO = """MuJoCo's mj_geomDistance answers some of the queries too, and is checked likewise, plus the rounding of
its vertices, which it keeps in single precision. Its faults are its own: they are not counted above."""


def _bodies(rows: Sequence[Row]) -> str:
    """Format the kinds of bodies of some rows, each with its sizes."""
    sizes: dict[Any, list[float]] = {}
    for row in rows:
        sizes.setdefault(row["kind"], []).append(row["diagonal"])
    return "; ".join(
        f"{kind} of {', '.join(map(length, ordered('diagonal', sizes[kind])))}" for kind in ordered("kind", sizes)
    )


# labels and order of rows

UNITS = (("km", 1e3, 1e3), ("m", 1.0, 1.0), ("cm", 1e-2, 1e-2), ("mm", 1e-3, 1e-4), ("µm", 1e-6, 0.0))
"""Units of length: name, size in metres, and smallest length in metres for which it is used."""


def length(metres: float) -> str:
    """Format a length for people."""
    if metres == 0:
        return "0"
    unit, size = next((unit, size) for unit, size, least in UNITS if metres >= 0.9999 * least)
    return f"{metres / size:.4g} {unit}"


def words(key: str, value: Any) -> str:
    """Format a value of a key for a table."""
    if value is None:
        return "–"
    if key == "diagonal":
        return length(value)
    if key == "translation":
        return f"{length(value)} away" if value else "at the origin"
    return f"batch {value}" if key == "batch" else str(value)


def ordered(key: str, values: Iterable[Any]) -> list[Any]:
    """Return the distinct values of a key, in display order."""
    found = set(values)
    if key in ORDER:
        return [value for value in ORDER[key] if value in found]
    return sorted(found, key=lambda value: (value is not None, value))


def faults(row: Row) -> str:
    """Describe the faults of a cell; empty: none."""
    return ", ".join(f"{row[name]} {FAULT_LABELS[name]}" for name in WRONG if row[name])


OPTIONS = ("dtype", "batch", "engine", "translation", "method", "neighborhood")
"""Keys of the options of a query; each has an option of its plural."""


def again(row: Row, seed: int) -> str:
    """Return the command line that repeats this cell alone."""
    count = "queries" if row["measure"] == "forward" else "differentiated"
    asked = ["--kinds", row["kind"], "--diagonals", repr(float(row["diagonal"])), "--states", row["state"]]
    asked += ["--measures", row["measure"]]
    for name in OPTIONS:
        if row[name] is not None and not (name == "translation" and row["measure"] == "derivative"):
            value = repr(float(row[name])) if name == "translation" else str(row[name])
            asked += ["--batches" if name == "batch" else f"--{name}s", value]
    asked += [f"--{count}", str(row["queries"]), *(["--seed", str(seed)] if seed else [])]
    return shlex.join(["refine-grasp", "bench", "stability", *asked])
