"""Error and misses against CPU time as SVG: a line for each solver, a point for each budget."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite
from typing import TYPE_CHECKING

from grasp_refine_apps.bench.grasp.labels import SIZES, label, sets_of
from grasp_refine_apps.bench.grasp.rows import Row
from grasp_refine_apps.report.html_page import COLORS, PLAIN
from grasp_refine_apps.report.panels import (
    MARKERS,
    Line,
    Style,
    count_axis,
    draw,
    logarithmic,
    number_height,
    share_axis,
    time_axis,
    time_height,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MIN_ERROR_M = 1e-8
"""Errors below this (metres) are drawn at it."""

Height = Callable[[Row], tuple[float, bool] | None]
"""Height of a row's point, and whether it is an upper bound; None: not drawn."""


def time_chart(rows: Sequence[Row]) -> str:
    """Chart median contact error, and share of grasps with a contact off by more than a millimetre, against CPU time.

    Args:
        rows: Pooled rows of tasks with targets.
    """
    panels: list[tuple[str, Height, Callable[[Axes, list[Line]], None]]] = [
        ("contact error, median  [m]", _error, _length_axis),
        ("grasps with a contact off by 1 mm", _misses, share_axis),
    ]
    sets = sets_of(rows)
    style = _styles(rows)
    grid = [[(name, _lines(rows, name, style, height), axis) for name in sets] for _, height, axis in panels]
    return draw(grid, [name for name, _, _ in panels], "CPU time per grasp", time_axis, "grasp", "Error over time")


def line_names(rows: Sequence[Row]) -> list[str]:
    """Label of the line of each row: a solver and, if there are several, its batch size."""
    several = {row["solver"] for row in rows if len({r["batch"] for r in rows if r["solver"] == row["solver"]}) > 1}
    return [f"{label(row)}, batch {row['batch']}" if row["solver"] in several else label(row) for row in rows]


def size_chart(rows: Sequence[Row], name: str) -> str:
    """Chart the cost of a grasp against a size in which variants differ; of contacts, also against the hand's joints.

    Args:
        rows: Pooled rows of tasks of one kind.
        name: One of `SIZES`.
    """
    rows = [row for row in rows if row[name] is not None]
    charts = [(name, _by(rows, SIZES[name], lambda row: _of_set(rows, row)))]
    if name == "contacts" and len({row["joints"] for row in rows}) > 1:
        charts.append(("joints", _by(rows, "joints", lambda row: f"contacts: {row['contacts']}")))
    measures: list[tuple[str, Callable[[Row], tuple[float, bool] | None], Callable[[Axes, list[Line]], None]]]
    measures = [("CPU time per grasp", _cost, time_height), ("CPU time per grasp and step", _step, time_height)]
    if name == "processes":
        measures[1] = ("grasps per second", _rate, number_height)
    return "".join(
        draw(
            [[(heading, lines(height), axis) for heading, height, axis in measures]],
            [f"by {x}"],
            x,
            count_axis,
            f"grasp {x}",
            f"Cost by {x}",
        )
        for x, lines in charts
    )


def _by(rows: Sequence[Row], x: str, line: Callable[[Row], str]) -> Callable[[Height], list[Line]]:
    """Return a function that gives the lines of a measure; points of a line at the same x are pooled to their mean."""
    names = list(dict.fromkeys(map(line, rows)))
    styles = dict(zip(names, _cycle(len(names)), strict=True))

    def lines(height: Height) -> list[Line]:
        found = []
        for name, style in styles.items():
            mine = [row for row in rows if line(row) == name]
            points = []
            for at in sorted({row[x] for row in mine}):
                values = [y[0] for row in mine if row[x] == at and (y := height(row)) is not None]
                if values:
                    points.append((at, sum(values) / len(values), False))
            if points:
                found.append(Line(name, style, *zip(*points, strict=True)))
        # A single point shows no trend, so it is dropped where others do.
        return [one for one in found if len(one.x) > 1] or found

    return lines


def _of_set(rows: Sequence[Row], row: Row) -> str:
    """Label of the set with the joints of its hand, and the solver if there are several."""
    several = len({label(one) for one in rows}) > 1
    return f"{row['set']} ({row['joints']} joints)" + (f", {label(row)}" if several else "")


def _cost(row: Row) -> tuple[float, bool]:
    return 1e-3 * row["cpu_ms_per_grasp"], False


def _step(row: Row) -> tuple[float, bool]:
    return 1e-3 * row["cpu_ms_per_grasp"] / row["iterations_mean"], False


def _rate(row: Row) -> tuple[float, bool] | None:
    return None if row["grasps_per_s"] is None else (row["grasps_per_s"], False)


def _cycle(count: int) -> list[Style]:
    """Styles for a number of lines."""
    dashes = ("-", "--", ":")
    return [
        Style(COLORS[k % len(COLORS)][0], MARKERS[k % len(MARKERS)], dashes[k // len(COLORS) % 3]) for k in range(count)
    ]


def _styles(rows: Sequence[Row]) -> dict[str, Style]:
    names = dict.fromkeys(line_names(rows))
    return dict(zip(names, _cycle(len(names)), strict=True))


def _lines(rows: Sequence[Row], name: str, styles: dict[str, Style], height: Height) -> list[Line]:
    found = []
    names = line_names(rows)
    for line, style in styles.items():
        mine = [row for row, own in zip(rows, names, strict=True) if row["set"] == name and own == line]
        mine.sort(key=lambda row: row["budget"])
        points = [(1e-3 * row["cpu_ms_per_grasp"], *y) for row in mine if (y := height(row)) is not None]
        if points:
            found.append(Line(line, style, *zip(*points, strict=True)))
    return found


def _error(row: Row) -> tuple[float, bool] | None:
    value = row["contact_error_median_m"]
    return (max(value, MIN_ERROR_M), value < MIN_ERROR_M) if value is not None and isfinite(value) else None


def _misses(row: Row) -> tuple[float, bool] | None:
    if row["acc_1e6"] is None:
        return None
    least, share = 0.5 / row["grasps"], 1.0 - row["acc_1e6"]
    return max(share, least), share < least


def _length_axis(axes: Axes, lines: list[Line]) -> None:
    """Draw a vertical axis of lengths, with a line at a millimetre."""
    values = [y for line in lines for y in line.y]
    logarithmic(axes.yaxis, axes.set_yscale, axes.set_ylim, [*values, 1e-3], _length)
    axes.axhline(1e-3, color=PLAIN["muted"][0], linewidth=0.8, dashes=(4, 3), zorder=2)


def _length(value: float) -> str:
    for unit, size in (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6)):
        if value >= 0.999 * size:
            return f"{value / size:.4g} {unit}"
    return f"{1e9 * value:.4g} nm"
