"""Panels of lines as SVG for the reports of benchmarks: axes of time and of shares, labels at the ends of lines.

Colours in the SVG are variables of the page that holds it (`stylesheet`), so that they follow its light or dark
mode. The same lines give the same bytes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from grasp_refine_apps.report.html_page import COLORS, PLAIN

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKERS = "os^DvPX*<>p"


@dataclass(frozen=True)
class Style:
    """Style of a variant's line, in all panels."""

    color: str
    marker: str
    dashes: str


@dataclass(frozen=True)
class Line:
    """Points of one variant in one panel."""

    label: str
    style: Style
    x: tuple[float, ...]
    y: tuple[float, ...]
    open: tuple[bool, ...]
    """True for points whose value is smaller than drawn."""


def draw(
    grid: Sequence[Sequence[tuple[str, list[Line], Callable[[Axes, list[Line]], None]]]],
    names: Sequence[str],
    x_name: str,
    x_axis: Callable[[Axes, list[Line]], None],
    salt: str,
    title: str,
) -> str:
    """Draw an SVG element of panels, one row per measure and one column per kind, labels right of the line ends.

    Args:
        grid: Title, lines and vertical axis of each panel.
        names: Label of the vertical axis of each row.
        x_name: Label of all horizontal axes.
        x_axis: Sets up a horizontal axis.
        salt: Keeps names in this SVG distinct from those of others on the page.
        title: Text for screen readers.
    """
    import matplotlib
    from matplotlib.figure import Figure

    columns = max((len(row) for row in grid), default=0)
    lines = [line for row in grid for _, its, _ in row for line in its]
    if not lines:
        return ""
    ink, muted, rule = (PLAIN[name][0] for name in ("ink", "muted", "line"))
    settings: dict[Any, Any] = {
        "svg.fonttype": "none",
        "svg.hashsalt": f"grasp-refine {salt}",
        "font.family": ["DejaVu Sans"],
        "font.size": 8.5,
        "text.color": ink,
        "axes.labelcolor": ink,
        "axes.edgecolor": muted,
        "axes.linewidth": 0.6,
        "xtick.color": muted,
        "ytick.color": muted,
        "grid.color": rule,
        "grid.linewidth": 0.6,
    }
    # Inches.
    left, label, gap, top, bottom = 0.62, 0.12 + 0.072 * max(len(line.label) for line in lines), 0.12, 0.3, 0.5
    width = 11.4 if columns > 1 else 7.2
    most = max(len(its) for row in grid for _, its, _ in row)
    high = max(2.5, 0.165 * most + 0.1)
    height = len(grid) * (high + top + bottom)
    wide = width / columns - left - label - gap
    with matplotlib.rc_context(settings):
        figure = Figure(figsize=(width, height))
        figure.patch.set_visible(False)
        for r, row in enumerate(grid):
            for c, (heading, its, y_axis) in enumerate(row):
                x0 = c * width / columns + left
                y0 = height - (r + 1) * (high + top + bottom) + bottom
                axes = figure.add_axes((x0 / width, y0 / height, wide / width, high / height))
                axes.set_title(f"{heading}: {names[r]}", loc="left", fontsize=9, fontweight="bold")
                _plot(axes, its)
                y_axis(axes, its)
                x_axis(axes, its)
                axes.set_xlabel(x_name)
                _label_ends(axes, its, high)
        out = io.StringIO()
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(out, format="svg", metadata=nothing)
    return _inlined(out.getvalue(), title)


def _plot(axes: Axes, lines: Sequence[Line]) -> None:
    axes.patch.set_visible(False)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(True)
    axes.set_axisbelow(True)
    for line in lines:
        color, its = line.style.color, line.style
        axes.plot(line.x, line.y, its.dashes, color=color, linewidth=1.6, zorder=3)
        for hollow in (False, True):
            chosen = np.array(line.open) == hollow
            axes.plot(
                np.array(line.x)[chosen],
                np.array(line.y)[chosen],
                its.marker,
                color=color,
                markersize=4.5,
                markerfacecolor=PLAIN["page"][0] if hollow else color,
                zorder=4,
            )


def _label_ends(axes: Axes, lines: Sequence[Line], high: float) -> None:
    """Write each label right of the panel of `high` inches, at the height of its line's end if space allows."""
    if not lines:
        axes.text(0.5, 0.5, "no data", transform=axes.transAxes, ha="center", color=PLAIN["muted"][0])
        return
    to_panel = axes.transData + axes.transAxes.inverted()
    ends = np.array([to_panel.transform((line.x[-1], line.y[-1]))[1] for line in lines])
    for line, at in zip(lines, spread(ends, 0.155 / high), strict=True):
        axes.annotate(
            line.label,
            (line.x[-1], line.y[-1]),
            (1.03, at),
            textcoords="axes fraction",
            va="center",
            color=line.style.color,
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": line.style.color, "linewidth": 0.5, "alpha": 0.5, "shrinkB": 3},
        )


def spread(heights: np.ndarray, gap: float) -> np.ndarray:
    """Heights (N,) moved apart to at least `gap`, in the same order, inside [0, 1] if they fit."""
    order = np.argsort(heights, kind="stable")
    placed = np.clip(heights[order], 0.0, 1.0)
    for _ in range(200):
        close = gap - np.diff(placed)
        if (close <= 1e-9).all():
            break
        push = np.maximum(close, 0.0) / 2
        placed[:-1] -= push
        placed[1:] += push
        if gap * (len(placed) - 1) <= 1.0:
            placed = np.clip(placed, gap * np.arange(len(placed)), 1.0 - gap * np.arange(len(placed))[::-1])
    result = np.empty_like(placed)
    result[order] = placed
    return result


def time_axis(axes: Axes, lines: list[Line]) -> None:
    """Set up a horizontal axis of seconds, wide enough for the lines."""
    logarithmic(axes.xaxis, axes.set_xscale, axes.set_xlim, [x for line in lines for x in line.x], _seconds)


def time_height(axes: Axes, lines: list[Line]) -> None:
    """Set up a vertical axis of seconds, wide enough for the lines."""
    logarithmic(axes.yaxis, axes.set_yscale, axes.set_ylim, [y for line in lines for y in line.y], _seconds)


def count_axis(axes: Axes, lines: list[Line]) -> None:
    """Set up a logarithmic horizontal axis of counts, with ticks at those that occur."""
    from matplotlib.ticker import FixedLocator, NullLocator

    values = sorted({x for line in lines for x in line.x})
    logarithmic(axes.xaxis, axes.set_xscale, axes.set_xlim, values, lambda value: f"{value:.3g}")
    axes.set_xlim(values[0] / 1.15, values[-1] * 1.15) if values else None
    axes.xaxis.set_major_locator(FixedLocator(values))
    axes.xaxis.set_minor_locator(NullLocator())


def number_height(axes: Axes, lines: list[Line]) -> None:
    """Set up a vertical axis of numbers from 0 on."""
    axes.set_ylim(0.0, 1.15 * max((y for line in lines for y in line.y), default=1.0))


def share_axis(axes: Axes, lines: list[Line]) -> None:
    """Set up a vertical axis of shares up to 100 %, logarithmic so that few misses stand out from none."""
    values = [y for line in lines for y in line.y]
    logarithmic(axes.yaxis, axes.set_yscale, axes.set_ylim, [*values, 1.0], lambda value: f"{100 * value:g} %")


def logarithmic(axis: Any, scale: Callable, limits: Callable, values: list[float], words: Callable) -> None:
    """Set up a logarithmic axis for values, with ticks at 1, 2 and 5 where there are few decades."""
    from matplotlib.ticker import LogLocator, NullFormatter, NullLocator

    low, high = (min(values), max(values)) if values else (0.1, 1.0)
    decades = np.log10(high / low)
    # Within less than a decade there would be ticks at any value, and too many.
    pad = 10 ** max(0.06 * decades, 0.12, 0.53 - 0.5 * decades)
    # In this order the old limits, which may be equal, are never made logarithmic.
    limits(low / pad, high * pad)
    scale("log")
    if decades < 2.2:
        axis.set_major_locator(LogLocator(10, subs=(1, 2, 5)))
        axis.set_minor_locator(NullLocator())
    else:
        axis.set_major_locator(LogLocator(10, numticks=10))
        axis.set_minor_locator(LogLocator(10, subs=(), numticks=10))
    axis.set_major_formatter(lambda value, _: words(value))
    axis.set_minor_formatter(NullFormatter())


def _seconds(value: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if value >= 0.999 * size:
            return f"{value / size:.4g} {unit}"
    return f"{1e6 * value:.4g} µs"


def _inlined(svg: str, title: str) -> str:
    """Extract the SVG element, at full width, with the page's variables for colours."""
    svg = svg[svg.index("<svg") :]
    head, body = svg.split(">", 1)
    head = re.sub(r' (width|height)="[^"]*"', "", head)
    # Names of groups would occur twice on a page with two charts; nothing refers to them.
    body = re.sub(r' id="[A-Za-z0-9]+_\d+"', "", body)
    body = body.replace("font-family: 'DejaVu Sans'", "font-family: inherit").replace("'DejaVu Sans'", "inherit")
    for name, (light, _) in {**{f"c{k}": pair for k, pair in enumerate(COLORS)}, **PLAIN}.items():
        body = body.replace(light, f"var(--{name})")
    return f'{head} class="chart" role="img" aria-label="{title}">{body}'
