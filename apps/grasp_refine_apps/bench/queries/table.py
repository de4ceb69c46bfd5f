"""The tables that the benchmark prints: a line for each case, then a line for each skip."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.box import SIMPLE
from rich.table import Table

from grasp_refine_apps.bench.queries.labels import bodies, cases, method, methods, queries, skips
from grasp_refine_apps.bench.queries.rows import Row

SHORT = {
    "python": "Py-\nthon",
    "bare-loop": "bare\nloop",
    "coal-fresh": "coal\nfresh",
    "coal-reused": "coal\nre-\nused",
    "mujoco": "Mu-\nJoCo",
}
"""Abbreviations of engines and peers for column heads."""


def bench_tables(rows: Sequence[Row]) -> Iterator[Table]:
    """Make the tables of query times and of savings by skips."""
    if queries(rows):
        yield _times(rows)
    if skips(rows):
        yield _saved(skips(rows))


def _times(rows: Sequence[Row]) -> Table:
    first = queries(rows)[0]["by"]
    others = [name for name in dict.fromkeys(row["by"] for row in queries(rows)) if name != first]
    table = _table(f"CPU µs of a witness query by engine {first}; of others, multiples of its time", "bodies")
    table.add_column("state", no_wrap=True)
    heads = ["batch", "for-\nward", "\nwarm", "asks"]
    heads += [f"back\n{method(key).split()[-1][:4]}" for key in methods(rows)]
    for head in (*heads, *(SHORT.get(name, name) for name in others)):
        table.add_column(head, justify="right", no_wrap=True)
    for its in cases(rows):
        cold, warm = (next(row for row in its if row["warm"] == which) for which in (False, True))
        ratios = {row["by"]: row["forward_ratio"] for row in its if not row["warm"]}
        table.add_row(
            bodies(cold),
            cold["state"],
            str(cold["batch"]),
            number(cold["forward_us"]),
            number(warm["forward_us"]),
            f"{cold['queries_asked'] / cold['poses']:.2f}",
            *(number(cold[key]) for key in methods(rows)),
            *(number(ratios[name]) for name in others),
        )
    errors = worst_errors(rows)
    if errors:
        said = "; ".join(f"{name} {error:.0e} (its tolerance {tolerance:.0e})" for name, error, tolerance in errors)
        table.caption = f"largest difference of signed distances from ours in m: {said}".replace("e-0", "e-")
        table.caption_justify = "left"
    return table


def worst_errors(rows: Sequence[Row]) -> list[tuple[str, float, float]]:
    """Largest difference of each peer's distances from ours, and its own tolerance, in metres."""
    found: dict[str, tuple[float, float]] = {}
    for row in queries(rows):
        if row["peer"]:
            worst, _ = found.get(row["by"], (0.0, 0.0))
            found[row["by"]] = max(worst, row["distance_error_m"]), row["tolerance_m"]
    return [(name, *both) for name, both in found.items()]


def _saved(rows: Sequence[Row]) -> Table:
    table = _table("skipped work, and the cost of doing it", "skipped")
    table.add_column("where", overflow="fold", max_width=18)
    for head in ("without", "with", "saved\n%", "CPU s\nwithout", "with"):
        table.add_column(head, justify="right", no_wrap=True)
    last = None
    for row in sorted(rows, key=lambda row: [other["skip"] for other in rows].index(row["skip"])):
        name = f"{row['skip']} ({row['unit']})" if row["skip"] != last else ""
        last = row["skip"]
        table.add_row(
            name,
            row["scene"],
            str(row["without"]),
            str(row["with"]),
            f"{100 * row['saved_share']:.0f}",
            *(f"{row[key]:.3f}" for key in ("cpu_without_s", "cpu_with_s")),
        )
    return table


def number(value: float | None) -> str:
    """Format a number with two digits or, from 100 on, as an integer."""
    if value is None:
        return "-"
    return f"{value:.0f}" if value >= 9.95 else f"{value:.1f}" if value >= 0.995 else f"{value:.2f}"


def _table(title: str, first: str) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE, padding=0, show_edge=False)
    table.add_column(first, overflow="fold", min_width=12, max_width=26)
    return table
