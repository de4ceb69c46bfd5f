"""The tables that the benchmark prints: a line for each method, then success by object."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import degrees, isfinite

from rich.box import SIMPLE
from rich.table import Table

from grasp_refine_apps.bench.hold.rows import Row, column

Column = tuple[str, Callable[[Row], str]]

HEADS = {"force-closure": "force-\nclos.", "strict": "strict", "tabletop": "table-\ntop"}
"""Abbreviations of the simulation settings for column heads."""

MAX_NAME_CHARACTERS = 30
"""Most characters of an object's name."""


def number(key: str, factor: float = 1.0, form: str = ".1f") -> Callable[[Row], str]:
    """Return a function that formats the number `key` of a row."""

    def words(row: Row) -> str:
        value = row[key]
        return "-" if value is None or not isfinite(value) else f"{factor * value:{form}}"

    return words


def _residual(row: Row) -> str:
    return number("wrench_residual_median", 1.0, ".0e")(row).replace("e-0", "e-")


def bench_tables(rows: Sequence[Row], settings: Sequence[str]) -> Iterator[Table]:
    """Make a table of the pooled rows, and one of success by object where there are several."""
    first = settings[0]
    columns: tuple[Column, ...] = (
        *((f"held,\n{HEADS[name]}", number(column("success", name), 100.0)) for name in settings),
        (f"lost,\n{HEADS[first]}", number(column("lost", first), 100.0)),
        ("CPU\nmean\nms", number("cpu_ms_mean", 1.0, ".0f")),
        ("pen.\nmean\nmm", number("penetration_mean_m", 1e3, ".3f")),
        ("self\nmax\nmm", number("self_penetration_max_m", 1e3, ".2f")),
        ("gap\nmm", number("contact_gap_median_m", 1e3, ".3f")),
        ("resi-\ndual", _residual),
        ("moved\nmm", number("moved_palm_median_m", 1e3)),
        ("\ndeg", number("moved_palm_median_rad", degrees(1.0))),
        ("AUC", number(column("auc", first), 1.0, ".2f")),
    )
    pooled = [row for row in rows if row["object"] == "all"]
    count = pooled[0]["grasps"]
    title = f"{count} grasp{'s' * (count != 1)}; held of all and lost of those that held before in %, else medians"
    table = _table(title, "refined")
    for name, _ in columns:
        table.add_column(name, justify="right", no_wrap=True)
    for row in pooled:
        table.add_row(row["label"], *(words(row) for _, words in columns))
    yield table
    objects = list(dict.fromkeys(row["object"] for row in rows if row["object"] != "all"))
    if objects:
        yield _by_object(rows, objects, settings)


def _by_object(rows: Sequence[Row], objects: Sequence[str], settings: Sequence[str]) -> Table:
    table = _table(f"held by object in %, {' / '.join(settings)}", "object")
    for label in dict.fromkeys(row["label"] for row in rows):
        table.add_column(label.replace(" ", "\n"), justify="right", no_wrap=True)
    for name in objects:
        cells = [
            "/".join(number(column("success", setting), 100.0, ".0f")(row) for setting in settings)
            for row in rows
            if row["object"] == name
        ]
        table.add_row(name, *cells)
    return table


def _table(title: str, first: str) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE, padding=0, show_edge=False)
    table.add_column(first, no_wrap=True, overflow="ellipsis", min_width=7, max_width=MAX_NAME_CHARACTERS)
    return table
