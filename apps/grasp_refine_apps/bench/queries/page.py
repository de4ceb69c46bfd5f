"""The report of the benchmark: one self-contained HTML file with charts and tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import log10
from typing import Any

from grasp_refine_apps.bench.queries.chart import NAMES, sweep_chart
from grasp_refine_apps.bench.queries.labels import PEER_LABELS, bodies, cases, method, methods, queries, skips
from grasp_refine_apps.bench.queries.rows import Row
from grasp_refine_apps.bench.queries.table import number, worst_errors
from grasp_refine_apps.report.html_page import Column, rendered

OURS = {"python": "our engine in Python", "bare-loop": "a loop in C++ over the queries of the compiled engine"}
"""Other engines -> explanation."""

MAX_RATIO = 1000.0
"""Ratio at which a bar has full length."""


def page(document: dict[str, Any]) -> str:
    """Render the report of a run of `bench queries` as HTML; equal input gives equal text.

    Args:
        document: The JSON document of the benchmark.
    """
    rows = document["rows"]
    charts = [(words, chart) for axis, words in NAMES.items() if (chart := sweep_chart(rows, axis))]
    return rendered(
        __package__,
        document=document,
        charts=charts,
        first=next((row["by"] for row in queries(rows)), ""),
        bars=_bars(rows),
        what=OURS | PEER_LABELS,
        errors=worst_errors(rows),
        columns=_columns(rows),
        lines=[{**row, "bodies": bodies(row)} for row in queries(rows)],
        saved=SAVED,
        skips=skips(rows),
    )


def _bars(rows: Sequence[Row]) -> list[tuple[str, list[tuple[str, str, float]]]]:
    """Compare the others of each case with our first engine: name, ratio in words and length in percent."""
    found = []
    for its in cases(rows):
        first, *others = (row for row in its if not row["warm"])
        bars = [(row["by"], f"{number(row['forward_ratio'])}x", _length(row["forward_ratio"])) for row in others]
        if bars:
            found.append((f"{bodies(first)}, {first['state']}, batch {first['batch']}", bars))
    return found


def _length(ratio: float) -> float:
    """Percent of the full length; a peer 100 times faster has length 0."""
    return max(0.0, min(100.0, 100 * (log10(ratio) + 2) / (log10(MAX_RATIO) + 2)))


def _value(key: str, form: str = "") -> Callable[[Row], str]:
    def words(row: Row) -> str:
        value = row[key]
        return "–" if value is None else f"{value:{form}}" if form else number(value)

    return words


def _columns(rows: Sequence[Row]) -> tuple[Column, ...]:
    return (
        Column("state", "how the bodies lie to each other", lambda row: row["state"]),
        Column("batch", "poses in a call", _value("batch", "d")),
        Column("by", "engine or peer", lambda row: row["by"]),
        Column("warm", "whether the last answer, a step away, was known", lambda row: "yes" if row["warm"] else ""),
        Column("forward", "CPU µs of a query per pose, median", _value("forward_us")),
        Column("layer", "CPU µs of a forward pass of the torch layer per pose, median", _value("layer_us")),
        *(Column(f"backward, {method(key)}", "CPU µs of a backward pass per pose, median", _value(key))
          for key in methods(rows)),
        Column("ratio", "time over that of our first engine, cold, in the same round; median", _value("forward_ratio")),
        Column("poses", "queried poses", _value("poses", "d")),
        Column("queried", "queries of piece pairs in all", _value("queries_asked", "d")),
        Column("pruned", "piece pairs that were not queried", _value("pruned", "d")),
        Column("warm starts", "poses with a warm start of GJK", _value("queries_warm", "d")),
        Column("error", "largest difference of distances from ours in Python, m", _value("distance_error_m", ".1e")),
    )  # fmt: skip


def _seconds(key: str) -> Callable[[Row], str]:
    return lambda row: "–" if row[key] is None else f"{row[key]:.4f}"


SAVED = (
    Column("where", "hand, object, command", lambda row: row["scene"]),
    Column("counted", "counted work", lambda row: row["unit"]),
    Column("without", "count if it is done", _value("without", "d")),
    Column("with", "count as the program is", _value("with", "d")),
    Column("saved, %", "of the count", lambda row: f"{100 * row['saved_share']:.1f}"),
    Column("CPU s without", "of the whole run named on the left", _seconds("cpu_without_s")),
    Column("CPU s with", "as the program is", _seconds("cpu_with_s")),
    Column("difference", "largest difference of refined poses (m) and joints (rad)", _value("difference", ".0e")),
    Column("how", "how the skip was undone", lambda row: row["how"]),
)
