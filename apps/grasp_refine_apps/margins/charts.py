"""Charts of margins; the same numbers give the same bytes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.results.margins_table import Limit
from grasp_refine.validation.margins.margins import Margins
from grasp_refine_apps.report.html_page import COLORS
from grasp_refine_apps.report.svg_chart import INK, MUTED, add_tooltip, svg_chart

BAR_IN, GAP_IN, BARS_WIDTH_IN = 0.18, 0.13, 8.5
"""Height of a bar, gap between groups of bars, and width of the chart of bars, inches."""
CURVE_WIDTH_IN, CURVE_HEIGHT_IN = 4.2, 2.1
"""Size of the chart of a curve, inches."""


@dataclass(frozen=True, eq=False)
class Side:
    """Grasps of one file."""

    name: str
    """Name in legends."""
    margins: Margins
    """Their margins."""


def color_names(count: int) -> list[str]:
    """Return the page's name of the colour of each of some sides; before, of two, is grey."""
    return ["muted", "c0"] if count == 2 else [f"c{k % len(COLORS)}" for k in range(count)]


def _colors(count: int) -> list[str]:
    return [MUTED if name == "muted" else COLORS[int(name[1:])][0] for name in color_names(count)]


def factor_bars(sides: Sequence[Side]) -> str:
    """Draw an SVG element: a bar of the mean probability with its interval, for each trial and side."""
    trials = list(dict.fromkeys(name for side in sides for name in side.margins.trials))
    thick = BAR_IN / (BAR_IN * len(sides) + GAP_IN)
    height = BAR_IN / thick * len(trials) + 0.3
    with svg_chart("mean probability of holding by factor", BARS_WIDTH_IN, height, look="margins") as drawn:
        axes = drawn.figure.subplots()
        for k, (side, color) in enumerate(zip(sides, _colors(len(sides)), strict=True)):
            for row, name in enumerate(trials):
                if name not in side.margins.trials:
                    continue
                mean, low, high = (100.0 * value for value in side.margins.mean(name))
                at, numbers = row + thick * (k - (len(sides) - 1) / 2), f"{mean:.1f} % ({low:.1f} to {high:.1f})"
                (bar,) = axes.barh(at, mean, 0.9 * thick, color=color, clip_on=False)
                add_tooltip(bar, f"{side.name}, {name}: {numbers}")
                axes.errorbar(
                    mean,
                    at,
                    xerr=[[mean - low], [high - mean]],
                    fmt="none",
                    ecolor=INK,
                    elinewidth=1.0,
                    capsize=2.0,
                    clip_on=False,
                )
                axes.text(102.0, at, numbers, color=MUTED, va="center")
        axes.set_yticks(range(len(trials)), trials, color=INK)
        axes.set(xlim=(0.0, 100.0), ylim=(len(trials) - 0.5, -0.5))
        axes.set_xticks((0, 25, 50, 75, 100), [f"{tick} %" for tick in (0, 25, 50, 75, 100)])
        axes.grid(visible=False, axis="y")
    return drawn.svg


def limit_curve(limit: Limit, sides: Sequence[Side]) -> str:
    """Draw an SVG element: the share of the grasps that hold, against friction, force or torque."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    places = np.geomspace(*limit.range, 129)
    title = f"share of grasps that hold by {limit.title}"
    with svg_chart(title, CURVE_WIDTH_IN, CURVE_HEIGHT_IN, look="margins") as drawn:
        axes = drawn.figure.subplots()
        for side, color in zip(sides, _colors(len(sides)), strict=True):
            if side.margins.limits is None:
                continue
            values = limit.of(side.margins.limits)[:, None]
            held = values <= places if limit.lower_is_better else values >= places
            (line,) = axes.semilogx(places, 100.0 * held.mean(axis=0), color=color, linewidth=1.8, clip_on=False)
            add_tooltip(line, side.name)
        axes.set(xlim=limit.range, ylim=(0.0, 100.0), yticks=(0, 50, 100))
        axes.xaxis.set_major_locator(LogLocator(10, subs=(1, 2, 5), numticks=20))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.grid(visible=False, axis="x")
    return drawn.svg
