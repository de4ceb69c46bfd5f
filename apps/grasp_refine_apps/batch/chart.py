"""Distributions before and after as bar charts; the same counts give the same bytes."""

from __future__ import annotations

from collections.abc import Mapping
from math import floor, log10

import numpy as np

from grasp_refine.measures.measures import COMPARED, MEASURES, METRE, MOVEMENTS, QUALITY, RADIAN, Measure
from grasp_refine.results.verdict import HOLDS
from grasp_refine_apps.batch import words
from grasp_refine_apps.batch.histogram import Histogram
from grasp_refine_apps.report.html_page import COLORS
from grasp_refine_apps.report.svg_chart import MUTED, RULE, add_tooltip, svg_chart

WIDTH_IN, HEIGHT_IN = 4.2, 1.75
"""Size of a chart in inches."""
BINS_PER_BAR = 4
"""Number of bins drawn as one bar: five bars per power of ten, or 25 of the quality."""
ZERO_BAR = -1.5
"""Place of the bar of values below all others, in bars from the first of the others."""
LABEL_DISTANCE = 0.1
"""Smallest distance of a label from that of the bar of zeros, as a share of the axis."""
MIN_BARS = 10
"""Minimum number of bars, so that few bars are not huge."""

CHARTED = MEASURES.view(lambda every: (*COMPARED, *MOVEMENTS))
"""Measures that are drawn."""
MARKS = {QUALITY.name: HOLDS}
"""Name of a measure -> value that a dashed line marks."""
HINTS = {QUALITY.name: "; a grasp of the dashed line or more should hold"}
"""Name of a measure -> addition to its explanation."""

_TEXTS = {METRE: words.millimetres, RADIAN: words.degrees}


def hint(measure: Measure) -> str:
    """Return the explanation of a measure and of the mark in its chart."""
    return measure.hint + HINTS.get(measure.name, "")


def value_text(measure: Measure, value: float) -> str:
    """Return a value in SI units as people read it, without its unit."""
    return _TEXTS.get(measure.unit, words.plain)(value)


def statistics_row(measure: Measure, distributions: Mapping[str, Histogram]) -> list[str]:
    """Mean, median, bound that 19 of 20 grasps meet, and worst value; before, and after."""
    cells = []
    for histogram in _sides(measure, distributions):
        if not histogram.count:
            cells += [words.NONE] * 4
            continue
        worst = (
            (histogram.quantile(0.05), histogram.least)
            if measure.better == "higher"
            else (histogram.quantile(0.95), histogram.most)
        )
        cells += [value_text(measure, value) for value in (histogram.mean, histogram.quantile(0.5), *worst)]
    return cells


def _sides(measure: Measure, distributions: Mapping[str, Histogram]) -> tuple[Histogram, Histogram]:
    """Return the distributions before and after; an empty one before of a measure that is not compared."""
    *_, after = found = [distributions[entry] for entry in measure.entries.values()]
    return (found[0] if measure.compared else Histogram.of(measure.unit)), after


def chart(measure: Measure, distributions: Mapping[str, Histogram]) -> str:
    """Draw an SVG element: bars of the share of grasps, before behind after; empty where nothing was measured."""
    sides = _sides(measure, distributions)
    if not any(histogram.count for histogram in sides):
        return ""
    whole = sides[1]
    zero, shares, edges = _shown(*sides)
    places = np.arange(shares.shape[1], dtype=float)
    if zero.any():
        places, shares = np.append(ZERO_BAR, places), np.column_stack([zero, shares])
    with svg_chart(f"distribution of {measure.title}", WIDTH_IN, HEIGHT_IN, look="bars") as drawn:
        axes = drawn.figure.subplots()
        axes.bar(places, shares[0], 0.92, color=RULE, edgecolor=MUTED, linewidth=0.6, clip_on=False)
        axes.bar(places, shares[1], 0.6, color=COLORS[0][0], clip_on=False)
        for place, bar in zip(places, axes.bar(places, shares.max(), 1.0, alpha=0.0, clip_on=False), strict=True):
            low, high = (0.0, whole.low) if place < 0 else edges[int(place) : int(place) + 2]
            add_tooltip(
                bar, f"{_range_text(measure, low, high, whole)}: {_shares_text(measure, shares[:, places == place])}"
            )
        if measure.name in MARKS:
            at = np.interp(MARKS[measure.name], edges, np.arange(len(edges))) - 0.5
            axes.axvline(at, color=COLORS[2][0], linewidth=1.2, dashes=(4, 3), clip_on=False)
        ticks = _ticks(measure, edges, whole.linear)
        if zero.any():
            # No label overlaps that of the bar of zeros.
            least = ZERO_BAR + LABEL_DISTANCE * len(places)
            ticks = {place: text if place > least else "" for place, text in ticks.items()} | {ZERO_BAR: "~0"}
        axes.set_xticks(list(ticks), list(ticks.values()))
        axes.set(xlim=(places[0] - 0.55, places[-1] + 0.55), ylim=(0.0, shares.max()), yticks=())
        axes.spines["left"].set_visible(False)
        axes.grid(visible=False)
    return drawn.svg


def _shown(*sides: Histogram) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the drawn shares (2,) below all bars, shares (2, bars), and the edges (bars + 1,) of the bars."""
    zero, *inner, above = np.array([histogram.shares(BINS_PER_BAR) for histogram in sides]).T
    shares = np.column_stack(inner)
    shares[:, -1] += above
    most = shares.shape[1] - 1
    used = np.flatnonzero(shares.any(axis=0))
    first, last = (0, most) if sides[0].linear else (used[0], used[-1]) if len(used) else (0, 0)
    while last - first + 1 < min(MIN_BARS, most + 1):
        first, last = max(first - 1, 0), min(last + 1, most)
    return zero, shares[:, first : last + 1], sides[0].edges[::BINS_PER_BAR][first : last + 2]


def _ticks(measure: Measure, edges: np.ndarray, linear: bool) -> dict[float, str]:
    """Return place -> label: quarters, or powers of ten in the unit that people read."""
    low, high = edges[0], edges[-1]
    if linear:
        places = np.linspace(-0.5, len(edges) - 1.5, 5).tolist()
        return {place: f"{low + (high - low) * k / 4:g}" for k, place in enumerate(places)}
    unit, symbol = 1.0 / measure.unit.factor, measure.unit.symbol
    found = {}
    for power in range(floor(log10(low / unit)), floor(log10(high / unit)) + 2):
        value = 10.0**power * unit
        if low * 0.999 <= value <= high * 1.001:
            text = f"{10.0**power:g}" if -3 <= power <= 4 else f"1e{power}"
            text = words.axis_length(value) if measure.unit == METRE else f"{text}{symbol}"
            place = (len(edges) - 1) * log10(value / low) / log10(high / low) - 0.5
            found[place] = text if power % 2 == 0 or high / low < 1e4 else ""
    return found


def _range_text(measure: Measure, low: float, high: float, whole: Histogram) -> str:
    """Return text on the range of values of a bar."""
    if high <= whole.low:
        text = f"below {value_text(measure, high)}"
    elif high >= whole.high and measure.better != "higher":
        text = f"{value_text(measure, low)} or more"
    else:
        text = f"{value_text(measure, low)} to {value_text(measure, high)}"
    return f"{text} {measure.unit.symbol}".rstrip()


def _shares_text(measure: Measure, shares: np.ndarray) -> str:
    before, after = (f"{100 * share:.1f} %" for share in shares.ravel())
    return f"{before} before, {after} after" if measure.compared else after
