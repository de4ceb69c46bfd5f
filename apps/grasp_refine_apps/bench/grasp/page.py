"""The report of the grasp benchmark: one self-contained HTML file with a chart and tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import degrees
from typing import Any

from grasp_refine.refinement.solvers.status import Status
from grasp_refine_apps.bench.grasp.chart import size_chart, time_chart
from grasp_refine_apps.bench.grasp.labels import SIZES, batch, deep, label, pooled, sets_of, varied
from grasp_refine_apps.bench.grasp.rows import PARTS, Row
from grasp_refine_apps.report.html_page import Column, rendered


def _number(key: str, factor: float = 1.0, form: str = ".3g") -> Callable[[Row], str]:
    def words(row: Row) -> str:
        value = row[key]
        return "–" if value is None else f"{factor * value:{form}}"

    return words


def _percent(key: str) -> Callable[[Row], str]:
    return _number(key, 100.0, ".2f")


def _millimetres(key: str) -> Callable[[Row], str]:
    """Return a function that formats a length; below a tenth of a micrometre, digits are meaningless."""

    def words(row: Row) -> str:
        value = row[key]
        return "–" if value is None else "< 1e-4" if value < 1e-7 else f"{1e3 * value:.3g}"

    return words


def _statuses(row: Row) -> str:
    counts = {one.label: row[f"status_{one.name.lower()}"] for one in Status if one != Status.RUNNING}
    return ", ".join(f"{count} {name}" for name, count in counts.items() if count)


def _moved(row: Row) -> str:
    palm, turned, joints = (row[f"moved_{name}"] for name in ("palm_median_m", "palm_median_rad", "joints_median_rad"))
    if palm is None:
        return "–"
    return f"{1e3 * palm:.1f} mm, {degrees(turned):.1f}°; {degrees(joints):.1f}°"


PENETRATION = (
    Column("pen. before", "deepest penetration of any link in mm, mean", _millimetres("penetration_before_mean_m")),
    Column("pen. after", "mean after refinement", _millimetres("penetration_after_mean_m")),
    Column("p95", "19 of 20 are smaller", _millimetres("penetration_after_p95_m")),
    Column("worst", "the largest", _millimetres("penetration_after_worst_m")),
    Column("≤ 0.05 mm, %", "share of grasps", _percent("penetration_after_share_50um")),
    Column("self before", "links in each other, mm, worst", _millimetres("self_penetration_before_worst_m")),
    Column("self after", "worst after refinement", _millimetres("self_penetration_after_worst_m")),
    Column("> 0.01 mm, %", "share of grasps", _percent("self_penetration_after_share_above_10um")),
)
COSTS = (
    Column("iterations", "mean", _number("iterations_mean", 1.0, ".1f")),
    Column("median", "of the iterations", _number("iterations_median", 1.0, ".0f")),
    Column("queries", "narrow-phase queries per grasp, mean", _number("queries_mean", 1.0, ".0f")),
    Column("CPU ms", "per grasp, of whole calls, mean", _number("cpu_ms_per_grasp")),
    Column("median", "of the CPU ms, where there are several calls", _number("cpu_ms_per_grasp_median")),
    Column("wall ms", "per grasp, of whole calls, mean", _number("wall_ms_per_grasp")),
    Column("loop ms", "CPU per grasp as counted by the solver itself", _number("solver_cpu_ms_per_grasp")),
    Column("contacts", "links that should touch, mean", _number("contacts_mean", 1.0, ".3g")),
    Column("joints", "independent joints of the hand", _number("joints", 1.0, ".0f")),
    Column("pieces", "convex pieces of the object, mean", _number("pieces_mean", 1.0, ".3g")),
    Column("per s", "grasps per second of the clock, of all processes together", _number("grasps_per_s", 1.0, ".1f")),
    Column("limits", "joint values beyond their limits", _number("limits_violated", 1.0, ".0f")),
    Column("moved", "median; base link, and the joint that moved most", _moved),
    Column("ended as", "how the solver ended", _statuses),
)
RESULTS = {
    "targets": (
        Column("Acc@1e-6", "share of grasps in % whose contacts are all below 1e-6 m² (1 mm)", _percent("acc_1e6")),
        Column("Acc@1e-8", "share of grasps in % whose contacts are all below 1e-8 m² (0.1 mm)", _percent("acc_1e8")),
        Column("median", "error of the worst contact of a grasp in mm", _millimetres("contact_error_median_m")),
        Column("worst", "error of the worst contact of the worst grasp in mm", _millimetres("contact_error_worst_m")),
        *PENETRATION,
    ),
    "nothing": (
        *PENETRATION,
        Column("gap", "of the links that should touch in mm, median", _millimetres("gap_median_m")),
        Column("p90", "nine of ten are smaller", _millimetres("gap_p90_m")),
        Column("worst", "the largest", _millimetres("gap_worst_m")),
        Column("deep stuck", "starts 10 mm deep or more: number that did not escape, of all", deep),
    ),
}
HEADS = {"targets": "Given targets", "nothing": "Given nothing"}


def page(document: dict[str, Any]) -> str:
    """Render the report of a run of `bench grasp` as HTML; equal input gives equal text.

    document: The JSON document of the benchmark.
        document: What the benchmark writes as JSON.
    """
    rows = document["rows"]
    return rendered(
        __package__,
        document=document,
        chart=_over_time(pooled(rows, "targets")),
        sizes=_by_size(rows),
        differ=[name for name in varied(rows) if name != "batch"],
        parts=tuple(PARTS),
        tables=[(HEADS[task], RESULTS[task], _lines(rows, task)) for task in RESULTS if pooled(rows, task)],
        costs=COSTS,
        stuck=_stuck(rows),
    )


def _over_time(rows: Sequence[Row]) -> str:
    """Chart error against time, where only budgets, solvers or batches differ."""
    return "" if set(varied(rows)) - {"batch"} else time_chart(rows)


def _by_size(rows: Sequence[Row]) -> list[tuple[str, str, str]]:
    """Make a chart for each size that differs and each kind of task; both are named in words."""
    found = []
    for task, head in HEADS.items():
        mine = pooled(rows, task)
        found += [(name, head, size_chart(mine, name)) for name in SIZES if name in varied(mine)]
    return found


def _shares(row: Row) -> list[tuple[str, float]]:
    """Percentages of the CPU time by part."""
    return [(name, 100.0 * share) for name in PARTS if (share := row["cpu_share"][name]) is not None]


def _lines(rows: Sequence[Row], task: str) -> list[tuple[str, list[Row], list[Row]]]:
    """Return the name of each set, its pooled rows, and those by object; each with its label."""
    mine = [row for row in rows if row["task"] == task]
    found = []
    for name in sets_of(mine):
        its = [
            {**row, "label": label(row), "batch_words": batch(row), "shares": _shares(row)}
            for row in mine
            if row["set"] == name
        ]
        found.append(
            (name, [row for row in its if row["object"] == "all"], [row for row in its if row["object"] != "all"])
        )
    return found


def _stuck(rows: Sequence[Row]) -> list[tuple[str, str, float, float]]:
    """Grasps that some Levenberg-Marquardt run did not free: set, name, and depths in mm before and after."""
    found = {
        (row["set"], f"{one['object']} {one['index']}"): (
            1e3 * one["penetration_before_m"], 1e3 * one["penetration_after_m"],
        )
        for row in pooled(rows, "nothing")
        if row["solver"] == "levenberg-marquardt"
        for one in row["deep_stuck_grasps"]
    }  # fmt: skip
    return [(*name, *depths) for name, depths in found.items()]
