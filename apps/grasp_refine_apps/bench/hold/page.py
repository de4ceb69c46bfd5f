"""The report of the benchmark: one self-contained HTML file with a chart and tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import degrees
from typing import Any

from grasp_refine_apps.bench.hold.chart import success_chart
from grasp_refine_apps.bench.hold.rows import Row, column
from grasp_refine_apps.bench.hold.table import number
from grasp_refine_apps.report.html_page import Column, rendered


def page(document: dict[str, Any], settings: Sequence[str]) -> str:
    """Render the report of a run of `bench hold` as HTML; equal input gives equal text.

    Args:
        document: The JSON document of the benchmark.
        settings: Names of the simulation settings.
    """
    rows = document["rows"]
    return rendered(
        __package__,
        document=document,
        settings=settings,
        chart=success_chart(rows, settings),
        tables=(
            ("Grasps that hold", _verdicts(settings)),
            ("Costs", COSTS),
            ("Geometry of the grasps", GEOMETRY),
        ),
        pooled=[row for row in rows if row["object"] == "all"],
        by_object=[row for row in rows if row["object"] != "all"],
    )


def _verdicts(settings: Sequence[str]) -> tuple[Column, ...]:
    return tuple(
        one
        for name in settings
        for one in (
            Column(f"{name}, %", "grasps that hold", number(column("success", name), 100.0)),
            Column("lost, %", "of the input grasps that held", number(column("lost", name), 100.0)),
            Column("AUC", "of the quality against success", number(column("auc", name), 1.0, ".3f")),
            Column("failed", "grasps by reason of failure", _reasons(column("reasons", name))),
        )
    )


def _reasons(key: str) -> Callable[[Row], str]:
    return lambda row: ", ".join(f"{count} {name}" for name, count in row[key].items()) or "-"


def _moved(row: Row) -> str:
    palm, turned, joints = (row[f"moved_{name}"] for name in ("palm_median_m", "palm_median_rad", "joints_median_rad"))
    if palm is None:
        return "-"
    return f"{1e3 * palm:.1f} mm, {degrees(turned):.1f}°; {degrees(joints):.1f}°"


COSTS = (
    Column("CPU ms", "of refining a grasp, mean", number("cpu_ms_mean")),
    Column("median", "CPU ms of refining a grasp, median", number("cpu_ms_median")),
    Column("wall ms", "of refining a grasp, mean", number("wall_ms_mean")),
    Column("median", "wall ms of refining a grasp, median", number("wall_ms_median")),
    Column("stages, CPU ms", "of finding pregrasp and squeeze of a grasp, mean", number("stages_cpu_ms")),
    Column("starts", "number of starts of a grasp, mean", number("starts_mean", 1.0, ".2f")),
    Column("moved", "median; base link, and the joint that moved most", _moved),
)
GEOMETRY = (
    Column("pen. mm", "deepest penetration of any link, mean", number("penetration_mean_m", 1e3, ".4f")),
    Column("p95", "19 of 20 are smaller", number("penetration_q95_m", 1e3, ".4f")),
    Column("self mm", "links in each other, worst", number("self_penetration_max_m", 1e3, ".4f")),
    Column("gap mm", "of the worst of the links that touch, median", number("contact_gap_median_m", 1e3, ".4f")),
    Column("residual", "wrench residual, median", number("wrench_residual_median", 1.0, ".1e")),
    Column("q75", "three of four are smaller", number("wrench_residual_q75", 1.0, ".1e")),
    Column("quality", "median", number("quality_median", 1.0, ".3f")),
)
