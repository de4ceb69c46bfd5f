"""The tables that the benchmark prints: counts by body and by state, of derivatives by method, and the worst cells."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from textwrap import wrap

from rich.box import SIMPLE
from rich.table import Table

from grasp_refine_apps.bench.stability.counts import error_of, group_rows, of_measure, total_counts, worst, wrong
from grasp_refine_apps.bench.stability.labels import again, faults, ordered, words
from grasp_refine_apps.bench.stability.rows import Row

FORWARD = (
    ("re-\nfused", "refused"),
    ("no\nans.", "failed"),
    ("not\nfin.", "not_finite"),
    ("bad\ndist.", "wrong_distance"),
    ("bad\nsign", "wrong_sign"),
    ("bad\npts.", "wrong_points"),
    ("points\njudged", "points_compared"),
    ("col-\nlaps.", "collapsed"),
    ("dist.\nerr.", "error_max"),
    ("pts.\nerr.", "points_error_max"),
)
"""Columns on queries, and their counts, or the error of which they show the largest."""

DERIVATIVE = (
    ("re-\nfused", "refused"),
    ("no\nanswer", "failed"),
    ("not\nfinite", "derivative_not_finite"),
    ("un-\nbounded", "derivative_unbounded"),
    ("\nwrong", "derivative_wrong_sign"),
    ("not\nscaled", "derivative_unscaled"),
    ("worst\nerror", "derivative_error_max"),
)
"""Columns on derivatives."""

MAX_WRONG_CELLS, MAX_NEAR_CELLS = 5, 2
"""Largest number of listed cells: if something is wrong, and of each precision if nothing is."""

LINE_CHARACTERS = 78
"""Characters of a line of a command, which continues after a backslash."""


def bench_tables(rows: Sequence[Row], seed: int, crashes: int) -> Iterator[Table | str]:
    """Yield counts of queries, counts of derivatives, the cells with the largest errors, and a summary.

    Args:
        rows: All rows.
        seed: Seed of the run.
        crashes: Number of tasks without rows.
    """
    forward, derivative = of_measure(rows, "forward"), of_measure(rows, "derivative")
    if forward:
        table = _table("wrong distances and points; errors are over their tolerance", "body")
        _columns(table, [head for head, _ in FORWARD])
        for key in ("kind", "state"):
            _counts(table, forward, key, FORWARD)
        yield table
    if derivative:
        table = _table("wrong derivatives; errors are over their tolerance", "method")
        _columns(table, [head for head, _ in DERIVATIVE])
        for key in ("method", "state"):
            _counts(table, derivative, key, DERIVATIVE)
        yield table
    yield "\n".join([*_worst(rows, seed), *summary(rows, crashes)])


def summary(rows: Sequence[Row], crashes: int) -> Iterator[str]:
    """Yield the numbers of queries and of faults in a line; one more of MuJoCo."""
    found = total_counts(rows)
    asked = [
        f"{total_counts(its)['queries']} {what}"
        for its, what in ((of_measure(rows, "forward"), "queries"), (of_measure(rows, "derivative"), "derivatives"))
        if its
    ]
    wrongs = f"{found.wrong} fault{'' if found.wrong == 1 else 's'}"
    collapsed = f", {found['collapsed']} collapsed" if found["collapsed"] else ""
    refused = f", {found['refused']} refused" if found["refused"] else ""
    crashed = f", {crashes} crashed" if crashes else ""
    if found["mujoco_queries"]:
        yield f"MuJoCo, at {found['mujoco_queries']} of the queries: {found['mujoco_wrong']} wrong"
    yield f"{found.cells} cells, {' and '.join(asked)}: {wrongs}{collapsed}{refused}{crashed}"


def _columns(table: Table, heads: Sequence[str]) -> None:
    for head in ("quer-\nies", *heads):
        table.add_column(head, justify="right", no_wrap=True)


def _counts(table: Table, rows: Sequence[Row], key: str, columns: Sequence[tuple[str, str]]) -> None:
    """Add a line for each value of a key; of states, one for all too."""
    groups = group_rows(rows, (key,))
    lines = [(words(key, value), total_counts(groups[value,])) for value in ordered(key, (row[key] for row in rows))]
    lines += [("all", total_counts(rows))] if key == "state" else []
    for name, found in lines:
        names = ["queries", *(of for _, of in columns)]
        cells = [number(found.largest[of]) if of in found.largest else str(found[of]) for of in names]
        table.add_row(name, *cells, style="bold" if found.wrong else None)
    if key != "state":
        table.add_section()


def number(value: float | None) -> str:
    """Format an error over its tolerance."""
    return "-" if value is None else "0" if value == 0 else f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e+")


def _worst(rows: Sequence[Row], seed: int) -> Iterator[str]:
    """Yield the wrong cells, or else those nearest to it, each with the command that repeats it."""
    shown = worst(rows, MAX_WRONG_CELLS, MAX_NEAR_CELLS)
    if shown:
        yield "wrong cells, and the commands that repeat them:" if wrong(shown[0]) else "nearest to being wrong:"
    for row in shown:
        error = error_of(row)
        said = [faults(row), row["dtype"], "" if error is None else f"error {number(error)} of its tolerance"]
        yield f"- {', '.join(filter(None, said))}"
        lines = wrap(
            again(row, seed), LINE_CHARACTERS, initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False
        )
        yield " \\\n".join(lines)
    if shown:
        yield ""


def _table(title: str, first: str) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE, padding=0, show_edge=False)
    table.add_column(first, overflow="fold", min_width=12, max_width=18)
    return table
