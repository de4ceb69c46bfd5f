"""The tables that the benchmark prints: one for each set and kind of task, a line for each variant."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

from rich.box import SIMPLE
from rich.table import Table

from grasp_refine_apps.bench.grasp.labels import SIZES, deep, label, pooled, sets_of
from grasp_refine_apps.bench.grasp.rows import Row

Column = tuple[str, Callable[[Row], str]]


def _number(key: str, factor: float, digits: int) -> Callable[[Row], str]:
    """Return a function that formats the number `key` of a row."""

    def words(row: Row) -> str:
        value = row[key]
        return "-" if value is None else f"{factor * value:.{digits}f}"

    return words


STEPS: Column = ("steps", _number("iterations_mean", 1.0, 0))
CPU: Column = ("CPU\nms", _number("cpu_ms_per_grasp", 1.0, 1))
WALL: Column = ("wall\nms", _number("wall_ms_per_grasp", 1.0, 1))
SPREAD: Sequence[Column] = (
    ("median\nmm", _number("contact_error_median_m", 1e3, 4)),
    ("worst\nmm", _number("contact_error_worst_m", 1e3, 2)),
)
TARGETS: Sequence[Column] = (
    ("Acc@\n1e-6", _number("acc_1e6", 100.0, 1)),
    ("Acc@\n1e-8", _number("acc_1e8", 100.0, 1)),
    *SPREAD,
    STEPS,
    CPU,
    WALL,
)
NOTHING: Sequence[Column] = (
    ("pen.\nbefore\nmean", _number("penetration_before_mean_m", 1e3, 2)),
    ("pen.\nafter\nmean", _number("penetration_after_mean_m", 1e3, 3)),
    ("≤.05\n%", _number("penetration_after_share_50um", 100.0, 1)),
    ("self\nworst", _number("self_penetration_after_worst_m", 1e3, 2)),
    ("gap\nmedian", _number("gap_median_m", 1e3, 3)),
    ("deep\nstuck", deep),
    STEPS,
    CPU,
    WALL,
)
TITLES = {
    "targets": "given targets; Acc in %",
    "nothing": "given nothing; lengths in mm",
}


def bench_tables(rows: Sequence[Row]) -> Iterator[Table]:
    """Make a table of the pooled rows for each kind of task and each set."""
    for task, columns in (("targets", TARGETS), ("nothing", NOTHING)):
        shown = pooled(rows, task)
        for name in sets_of(shown):
            mine = [row for row in shown if row["set"] == name]
            count = max(row["grasps"] for row in mine)
            yield _table(f"{name}, {count} grasps, {TITLES[task]}", mine, columns)


def _size(name: str, row: Row) -> str:
    return "all" if row[name] is None else f"{row[SIZES[name]]:g}"


def _table(title: str, rows: Sequence[Row], columns: Sequence[Column]) -> Table:
    budgets = len({(row["solver"], row["budget"]) for row in rows}) > len({row["solver"] for row in rows})
    if budgets:
        # Replaces the least informative columns.
        columns = (("budget", lambda row: str(row["budget"])), *(column for column in columns if column is not WALL))
    sizes = [name for name in SIZES if name == "batch" or len({row[name] for row in rows}) > 1]
    if set(sizes) > {"batch"}:
        # Again replaces the least informative column.
        columns = tuple(column for column in columns if column not in (WALL, *SPREAD))
    if "processes" in sizes:
        columns = (*columns, ("grasps\nper s", _number("grasps_per_s", 1.0, 1)))
    columns = (*((name, partial(_size, name)) for name in sizes), *columns)
    table = Table(title=title, title_justify="left", box=SIMPLE, padding=0, show_edge=False, min_width=len(title))
    table.add_column("solver", min_width=7)
    for name, _ in columns:
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(label(row), *(words(row) for _, words in columns))
    return table
