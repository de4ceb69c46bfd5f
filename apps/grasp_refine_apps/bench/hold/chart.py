"""Success against CPU time as SVG: a panel for all grasps and for each object, a line for each setting."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import floor
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine_apps.bench.hold.rows import Row, column
from grasp_refine_apps.report.html_page import COLORS, PLAIN
from grasp_refine_apps.report.panels import MARKERS, Line, Style, draw, spread, time_axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PANELS_PER_ROW = 2
"""Panels side by side."""

MAX_NAME_CHARACTERS = 40
"""Most characters of an object's name above a panel."""

DASHES = {"as-came": (5, 3), "own-stages": (1, 2)}
"""Dashes of the levels of grasps that are not refined."""


def success_chart(rows: Sequence[Row], settings: Sequence[str]) -> str:
    """Chart the share of grasps that hold against CPU time of refining one; unrefined grasps are levels.

    Args:
        rows: All rows.
        settings: Names of the simulation settings.
    """
    styles = {name: Style(COLORS[k][0], MARKERS[k], "-") for k, name in enumerate(settings)}
    panels = []
    for name in dict.fromkeys(row["object"] for row in rows):
        its = [row for row in rows if row["object"] == name]
        lines = [_line(its, setting, style) for setting, style in styles.items()]
        heading = name if len(name) <= MAX_NAME_CHARACTERS else f"{name[: MAX_NAME_CHARACTERS - 1]}…"
        levels = [
            (style, row["method"], row[column("success", setting)])
            for setting, style in styles.items()
            for row in its
            if row["cpu_ms_mean"] is None
        ]
        panels.append((heading, [line for line in lines if line.x], partial(_axis, its, levels)))
    grid = [panels[start : start + PANELS_PER_ROW] for start in range(0, len(panels), PANELS_PER_ROW)]
    names = ["grasps that hold"] * len(grid)
    return draw(grid, names, "CPU time of refining a grasp", time_axis, "hold", "Success against run time")


def _line(rows: Sequence[Row], setting: str, style: Style) -> Line:
    refined = sorted((row for row in rows if row["cpu_ms_mean"] is not None), key=lambda row: row["cpu_ms_mean"])
    x = tuple(1e-3 * row["cpu_ms_mean"] for row in refined)
    return Line(setting, style, x, tuple(row[column("success", setting)] for row in refined), (False,) * len(x))


def _axis(rows: Sequence[Row], levels: Sequence[tuple[Style, str, float]], axes: Axes, lines: list[Line]) -> None:
    """Draw a vertical axis of shares up to 100 %, with the levels, and the label of the method at each time."""
    values = [*(y for line in lines for y in line.y), *(at for _, _, at in levels)]
    # Tens of percent, with space for the labels below.
    low = max(0.0, floor(10 * min(values)) / 10 - 0.3)
    axes.set_ylim(low, 1.02)
    step = 0.1 if low > 0.35 else 0.2
    axes.set_yticks([1.0 - step * k for k in range(int((1.0 - low) / step + 1e-9) + 1)])
    axes.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
    for style, method, at in levels:
        axes.axhline(at, color=style.color, linewidth=0.9, dashes=DASHES[method], zorder=2)
    time_axis(axes, lines)
    muted = PLAIN["muted"][0]
    refined = [row for row in rows if row["cpu_ms_mean"] is not None]
    to_panel = axes.transData + axes.transAxes.inverted()
    places = np.array([to_panel.transform((1e-3 * row["cpu_ms_mean"], 1.0))[0] for row in refined])
    for row, place in zip(refined, spread(places - 0.012, 0.035), strict=True):
        axes.axvline(1e-3 * row["cpu_ms_mean"], color=muted, linewidth=0.5, dashes=(1, 2), zorder=1)
        axes.text(
            place, 0.02, row["label"], transform=axes.transAxes, rotation=90, ha="center", fontsize=7.5, color=muted
        )
