"""The table that the benchmark prints: one line for each variant and kind, pooled over pairs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rich.box import SIMPLE
from rich.table import Table

from grasp_refine_apps.bench.align.labels import Row, epsilons, labels_of


def _percent(value: float) -> str:
    return f"{100 * value:.1f}"


def _short(value: float) -> str:
    return f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e+")


Column = tuple[str, Callable[[Row], float | None], Callable[[float], str]]
COLUMNS: Sequence[Column] = (
    ("Acc@\n1e-6", lambda row: row["acc_1e6"], _percent),
    ("Acc@\n1e-8", lambda row: row["acc_1e8"], _percent),
    ("D5\nm²", lambda row: row["d5"], _short),
    ("D9\nm²", lambda row: row["d9"], _short),
    ("reach-\nable", lambda row: row["reachable"]["acc_1e6"], _percent),
    ("all\ndrawn", lambda row: row["unfiltered"]["acc_1e6"], _percent),
    ("last", lambda row: row["last"]["acc_1e6"], _percent),
    ("query\nµs", lambda row: _sum(row["forward_us"], row["backward_us"]), "{:.0f}".format),
    ("CPU s\na pair", lambda row: row["cpu_s_per_pair"], "{:.2f}".format),
)


DRAWN = "all\ndrawn"
PATCH: Sequence[Column] = (
    ("patch\n1e-6", lambda row: row["patch"] and row["patch"]["acc_1e6"], _percent),
    ("patch\n1e-8", lambda row: row["patch"] and row["patch"]["acc_1e8"], _percent),
)
"""Accuracies at the same poses by patch witness points; they replace the column of all drawn tasks."""


def _sum(*parts: float | None) -> float | None:
    known = [part for part in parts if part is not None]
    return sum(known) if len(known) == len(parts) else None


def bench_table(rows: Sequence[Row], title: str) -> Table:
    """Make a table of the pooled rows, with face-face targets on separate lines."""
    patch = epsilons(rows)
    columns = [*(column for column in COLUMNS if column[0] != DRAWN), *PATCH] if patch else COLUMNS
    if patch:
        title = f"{title}; patch: epsilon {patch}"
    labels = dict(zip(map(id, rows), labels_of(rows), strict=True))
    shown = [row for row in rows if row["pair"] == "all" and row["target_class"] in ("all", "face-face")]
    several = len({(row["budget"], row["budget_s"]) for row in shown}) > 1
    table = Table(title=title, title_justify="left", box=SIMPLE, padding=0, show_edge=False)
    table.add_column("variant", min_width=18)
    if several:
        table.add_column("budget", justify="right", no_wrap=True)
    for name, _, _ in columns:
        table.add_column(name, justify="right", no_wrap=True)
    kind = None
    for row in shown:
        if row["kind"] != kind:
            kind = row["kind"]
            table.add_section()
            table.add_row(f"[bold]{kind}[/bold], {row['pairs']} pair{'s' if row['pairs'] != 1 else ''}")
        name = labels[id(row)]
        if row["target_class"] == "face-face" and any(r["target_class"] == "all" and r is not row for r in shown):
            name = "  face-face"
        budget = [f"{row['budget']}" if row["budget"] else f"{row['budget_s']:g} s"] if several else []
        cells = [(words(value) if value is not None else "-") for value, words in _values(row, columns)]
        table.add_row(name, *budget, *cells)
    return table


def _values(row: Row, columns: Sequence[Column]) -> list[tuple[float | None, Callable[[float], str]]]:
    return [(value(row), words) for _, value, words in columns]
