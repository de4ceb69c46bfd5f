"""Time of a query over batch size, vertices and pieces as SVG: a line for each engine, peer and derivative."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from grasp_refine_apps.bench.queries.labels import label, method, methods, queries
from grasp_refine_apps.bench.queries.rows import Row
from grasp_refine_apps.report.panels import COLORS, MARKERS, Line, Style, draw, logarithmic

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Axis = Literal["batch", "vertices", "pieces"]

NAMES: dict[Axis, str] = {"batch": "poses in a call", "vertices": "vertices of a piece", "pieces": "pieces of a body"}
"""Names of the horizontal axes."""

PANELS_PER_ROW, MAX_PANELS = 2, 4
"""Panels side by side, and in all."""


def sweep_chart(rows: Sequence[Row], axis: Axis) -> str:
    """Chart CPU time of a query over one axis, a panel for all cases that differ only in it; empty without any.

    Args:
        rows: All rows.
        axis: The varied quantity.
    """
    fixed = [name for name in ("kind", "pieces", "vertices", "state", "batch") if name != axis]
    groups: dict[tuple[object, ...], list[Row]] = {}
    for row in queries(rows):
        groups.setdefault(tuple(row[name] for name in fixed), []).append(row)
    swept = {key: its for key, its in groups.items() if len({row[axis] for row in its}) > 1}
    styles = _styles(rows)
    panels = []
    for key, its in list(swept.items())[:MAX_PANELS]:
        words = dict(zip(fixed, key, strict=True))
        heading = ", ".join(
            [
                str(words["kind"]),
                *(f"{words[name]} {name}" for name in ("pieces", "vertices") if words.get(name, 1) != 1),
            ]
        )
        heading += f", {words['state']}" + (f", batch {words['batch']}" if "batch" in words else "")
        panels.append((heading, _lines(its, axis, styles), _time))
    grid = [panels[start : start + PANELS_PER_ROW] for start in range(0, len(panels), PANELS_PER_ROW)]

    def across(axes: Axes, lines: list[Line]) -> None:
        values = [x for line in lines for x in line.x]
        logarithmic(axes.xaxis, axes.set_xscale, axes.set_xlim, values, lambda value: f"{value:g}")

    title = f"Time of a query over {NAMES[axis]}"
    return draw(grid, ["time per pose"] * len(grid), NAMES[axis], across, f"queries {axis}", title)


def _styles(rows: Sequence[Row]) -> dict[str, Style]:
    names = list(dict.fromkeys(row["by"] for row in queries(rows)))
    found = {}
    for k, name in enumerate(names):
        color, marker = COLORS[k % len(COLORS)][0], MARKERS[k % len(MARKERS)]
        found[name], found[f"{name}, warm"] = Style(color, marker, "-"), Style(color, marker, ":")
    for k, key in enumerate(methods(rows), len(names)):
        found[key] = Style(COLORS[k % len(COLORS)][0], MARKERS[k % len(MARKERS)], "--")
    return found


def _lines(rows: Sequence[Row], axis: Axis, styles: dict[str, Style]) -> list[Line]:
    points: dict[str, list[tuple[int, float]]] = {}
    for row in sorted(rows, key=lambda row: row[axis]):
        points.setdefault(label(row), []).append((row[axis], 1e-6 * row["forward_us"]))
        for key in methods(rows):
            if row[key] is not None:
                points.setdefault(key, []).append((row[axis], 1e-6 * row[key]))
    lines = []
    for name, its in points.items():
        x, y = zip(*its, strict=True)
        words = f"backward, {method(name)}" if name in methods(rows) else name
        lines.append(Line(words, styles[name], x, y, (False,) * len(its)))
    return lines


def _time(axes: Axes, lines: list[Line]) -> None:
    values = [y for line in lines for y in line.y]
    logarithmic(axes.yaxis, axes.set_yscale, axes.set_ylim, values, _words)


def _words(value: float) -> str:
    return f"{1e3 * value:.4g} ms" if value >= 0.999e-3 else f"{1e6 * value:.4g} µs"
