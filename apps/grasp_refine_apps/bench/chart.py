"""The chart of benchmarks: lines of points in panels, as SVG in the colours of the page."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from grasp_refine_apps.report.html_page import COLORS
from grasp_refine_apps.report.svg_chart import MUTED, PAGE, svg_chart

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Row = dict[str, Any]
"""A flat entry of the results."""

MARKERS, DASHES = "os^DvPX*<>p", ("-", "--", ":")
"""Markers and dashes of lines; dashes change when the colours are used up."""

PANEL_WIDTH_IN, PANEL_HEIGHT_IN = 4.2, 2.8
"""Size of a panel in inches."""


@dataclass(frozen=True)
class Axis:
    """An axis of a chart, and the number that it shows."""

    key: str
    """Key of the number in a row."""
    name: str
    """Name of the quantity."""
    unit: str = ""
    """Unit of the number: "s" and "m" get prefixes, "%" is of shares from 0 to 1."""
    log: bool = True
    """Whether the axis is logarithmic."""
    least: float | None = None
    """Smallest number that is drawn; smaller numbers are at this height, with a hollow marker."""
    marks: tuple[float, ...] = ()
    """Numbers at which a dashed line is drawn."""
    steps: tuple[float, ...] = ()
    """All numbers, of a horizontal axis that draws them at equal steps; empty: to scale."""


@dataclass(frozen=True)
class Chart:
    """A row of panels for each vertical axis, a column for each kind of rows, and a line for each label."""

    title: str
    rows: Sequence[Row]
    """Points. Without a number on the horizontal axis (None), a point is a level, a line across the panel."""
    x: Axis
    y: Sequence[Axis]
    line: Callable[[Row], str]
    """Label of the line that a row is on."""
    panel: Callable[[Row], str] = lambda row: ""
    """Heading of the panel that a row is in."""
    note: str = ""
    """Paragraph below the chart."""

    def svg(self) -> str:
        """Draw the SVG element; equal rows give equal bytes. Empty without a point."""
        panels = list(dict.fromkeys(map(self.panel, self.rows)))
        if not panels:
            return ""
        labels = list(dict.fromkeys(map(self.line, self.rows)))
        size = PANEL_WIDTH_IN * len(panels) + 1.8, PANEL_HEIGHT_IN * len(self.y)
        with svg_chart(self.title, *size) as chart:
            figure = chart.figure
            grid = figure.subplots(len(self.y), len(panels), squeeze=False)
            for row, y in enumerate(self.y):
                for column, panel in enumerate(panels):
                    shown = [one for one in self.rows if self.panel(one) == panel]
                    self._draw(grid[row, column], shown, y, labels)
                    grid[row, column].set_title(panel, loc="left", fontsize=9, fontweight="bold")
            handles = {
                label: handle
                for axes in grid.flat
                for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
            }
            known = [label for label in labels if label in handles]
            figure.legend([handles[label] for label in known], known, loc="outside right upper")
        return chart.svg

    def _draw(self, axes: Axes, rows: Sequence[Row], y: Axis, labels: Sequence[str]) -> None:
        """Draw one panel."""
        for setting, set_scale in ((self.x, axes.set_xscale), (y, axes.set_yscale)):
            if setting.log and not setting.steps:
                set_scale("log")
        for k, label in enumerate(labels):
            color, marker = COLORS[k % len(COLORS)][0], MARKERS[k % len(MARKERS)]
            dash = DASHES[k // len(COLORS) % len(DASHES)]
            points = [
                (entry(row, self.x.key), entry(row, y.key))
                for row in rows
                if self.line(row) == label and _drawable(entry(row, y.key), y)
            ]
            for _, level in (point for point in points if point[0] is None):
                axes.axhline(level, color=color, linewidth=0.9, linestyle="--", label=label)
            points = sorted(point for point in points if point[0] is not None)
            if not points:
                continue
            across, height = np.array(points, dtype=float).T
            if self.x.steps:
                across = np.searchsorted(self.x.steps, across)
            low = -np.inf if y.least is None else y.least
            drawn = np.maximum(height, low)
            axes.plot(across, drawn, dash, marker=marker, color=color, markersize=4.5, linewidth=1.6, label=label)
            hollow = height < low
            axes.plot(across[hollow], drawn[hollow], marker, color=color, markersize=4.5, markerfacecolor=PAGE)
        for mark in y.marks:
            axes.axhline(mark, color=MUTED, linewidth=0.8, dashes=(4, 3), zorder=2)
        for axis, setting in ((axes.xaxis, self.x), (axes.yaxis, y)):
            _set_ticks(axis, setting)
        axes.set(xlabel=self.x.name, ylabel=y.name)


def entry(row: Row, key: str) -> Any:
    """Return the value of a row; a key such as "last.acc_1e6" is an entry of an entry. None where an entry is None."""
    found: Any = row
    for name in key.split("."):
        found = None if found is None else found[name]
    return found


def of_finite(statistic: Callable[..., Any], values: np.ndarray) -> float | None:
    """Return a statistic of the finite values; None without any."""
    finite = values[np.isfinite(values)]
    return float(statistic(finite)) if len(finite) else None


def group_rows(rows: Iterable[Row], keys: Sequence[str]) -> dict[tuple[object, ...], list[Row]]:
    """Group rows by the values of the keys."""
    found: dict[tuple[object, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), []).append(row)
    return found


def _drawable(value: float | None, axis: Axis) -> bool:
    """Return True if the axis can show a number."""
    return value is not None and bool(np.isfinite(value)) and (not axis.log or value > 0 or axis.least is not None)


def _set_ticks(axis: Any, setting: Axis) -> None:
    """Set ticks at 1, 2 and 5 where there are few decades, and write them with their unit."""
    from matplotlib.ticker import EngFormatter, Formatter, FuncFormatter, LogLocator, NullFormatter

    factor, unit = (100.0, " %") if setting.unit == "%" else (1.0, f" {setting.unit}".rstrip())
    form: Formatter = FuncFormatter(lambda value, _: f"{factor * value:.6g}{unit}")
    if setting.unit in ("s", "m"):
        form = EngFormatter(unit=setting.unit)
    if setting.steps:
        axis.set_ticks(range(len(setting.steps)), list(map(form, setting.steps)))
        return
    if setting.log:
        low, high = axis.get_view_interval()
        axis.set_major_locator(LogLocator(10, subs=(1, 2, 5) if high < 200 * low else (1,), numticks=10))
        axis.set_minor_formatter(NullFormatter())
    axis.set_major_formatter(form)
