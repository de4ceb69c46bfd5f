"""The report of the benchmark: one self-contained HTML file with heat maps and tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from grasp_refine_apps.bench.stability.cases import DTYPES
from grasp_refine_apps.bench.stability.chart import PALEST_ERROR, HeatMap, heat_map
from grasp_refine_apps.bench.stability.counts import error_of, group_rows, of_measure, total_counts, worst
from grasp_refine_apps.bench.stability.labels import FAULT_LABELS, again, faults, length, ordered, words
from grasp_refine_apps.bench.stability.rows import WRONG, Row
from grasp_refine_apps.bench.stability.table import number
from grasp_refine_apps.report.html_page import rendered

MAX_WRONG_CELLS = 40
"""Cells that are listed where something is wrong; where nothing is, `MAX_NEAR_CELLS` of each precision."""
MAX_NEAR_CELLS = 10

MAX_REASONS = 20
"""Largest number of different reasons of refusal that are listed."""


def page(document: dict[str, Any]) -> str:
    """Render the report of a run of `bench stability` as HTML; equal input gives equal text.

    Args:
        document: The JSON document of the benchmark.
    """
    rows = document["rows"]
    found = total_counts(rows)
    return rendered(
        __package__,
        document=document,
        totals=_totals(rows, len(document["problems"])),
        maps=_maps(rows),
        least=PALEST_ERROR,
        any_wrong=found.wrong > 0,
        worst=[_describe_cell(row, document["seed"]) for row in worst(rows, MAX_WRONG_CELLS, MAX_NEAR_CELLS)],
        refusals=_refusals(rows),
        mujoco=_mujoco(rows),
    )


def _totals(rows: Sequence[Row], crashes: int) -> list[tuple[str, str]]:
    """Counted quantities, and their totals."""
    forward, derivative, found = of_measure(rows, "forward"), of_measure(rows, "derivative"), total_counts(rows)
    lines = [("cells", len(rows)), ("queries", total_counts(forward)["queries"])]
    lines += [("witness points judged", found["points_compared"]), ("derivatives", total_counts(derivative)["queries"])]
    lines += [("refused with a reason", found["refused"]), ("collapsed", found["collapsed"])]
    lines += [(FAULT_LABELS[name], found[name]) for name in WRONG]
    return [(name, f"{count:,}".replace(",", "\u202f")) for name, count in [*lines, ("crashes", crashes)]]


def _maps(rows: Sequence[Row]) -> list[tuple[str, str, HeatMap]]:
    """Make each heat map with its title and description."""
    forward, derivative = of_measure(rows, "forward"), of_measure(rows, "derivative")
    body, way = ("kind", "diagonal"), ("dtype", "batch", "engine", "translation")
    method, moves = ("method", "neighborhood", "dtype"), "derivative_error_max"
    double, single = ([row for row in forward if row["dtype"] == dtype] for dtype in DTYPES)
    asked = [
        ("Signed distances by body and state", "Poses in double precision, queried in all ways.", double, body, "state",
         "error_max"),
        ("Signed distances by body and state, float32", "Poses in single precision, whose rounding is most of it.",
         single, body, "state", "error_max"),
        ("Signed distances by way of querying", "All bodies together.", forward, way, "state", "error_max"),
        ("Witness points by body and state", "Poses in double precision; the colour is of points and normals.", double,
         body, "state", "points_error_max"),
        ("Derivatives by method and state", "All bodies together.", derivative, method, "state", moves),
        ("Derivatives by method and size", "Body kinds and states together.", derivative, method, "diagonal", moves),
        ("Derivatives by body and state", "All methods together.", derivative, body, "state", moves),
    ]  # fmt: skip
    return [(title, what, heat_map(its, down, across, of)) for title, what, its, down, across, of in asked if its]


def _describe_cell(row: Row, seed: int) -> tuple[str, str, str, str]:
    """Describe a cell: its keys, its faults, its worst error, and the command that repeats it."""
    keys = ("kind", "diagonal", "state", "dtype", "batch", "engine", "translation", "method", "neighborhood")
    shown = ", ".join(words(key, row[key]) for key in keys if row[key] is not None)
    said = [faults(row), row["where"]]
    return shown, "; ".join(filter(None, said)), number(error_of(row)), again(row, seed)


def _refusals(rows: Sequence[Row]) -> list[tuple[str, int, str]]:
    """Reasons of refusal, their numbers, and the bodies."""
    found = group_rows((row for row in rows if row["refused"]), ("refusal",))
    return [
        (str(why or "no reason"), total_counts(its)["refused"], _bodies(its))
        for (why,), its in [*found.items()][:MAX_REASONS]
    ]


def _bodies(rows: Sequence[Row]) -> str:
    """Format the kinds of bodies of some rows, each with its sizes."""
    sizes = {kind: [row["diagonal"] for row in rows if row["kind"] == kind] for kind in {row["kind"] for row in rows}}
    return "; ".join(
        f"{kind} of {', '.join(map(length, ordered('diagonal', sizes[kind])))}" for kind in ordered("kind", sizes)
    )


def _mujoco(rows: Sequence[Row]) -> list[tuple[str, int, int]]:
    """Each kind of bodies with its queries of MuJoCo, and the wrong ones of them."""
    asked = [row for row in rows if row["mujoco_queries"]]
    kinds = ordered("kind", (row["kind"] for row in asked))
    each = [(kind, total_counts(row for row in asked if row["kind"] == kind)) for kind in kinds]
    return [(kind, its["mujoco_queries"], its["mujoco_wrong"]) for kind, its in each]
