"""Distributions before and after as SVG in the colours of the page; the same counts give the same bytes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from math import floor, log10

import numpy as np

from grasp_refine.measures.measures import COMPARED, MEASURES, METRE, MOVEMENTS, QUALITY, RADIAN, Measure
from grasp_refine.results.verdict import HOLDS
from grasp_refine_apps.batch import words
from grasp_refine_apps.batch.histogram import LINEAR, Histogram

WIDTH, BAR_HEIGHT, LEFT, TOP = 320, 104, 6, 8
"""Width of the drawing, height of the highest bar, and margins beside and above, SVG units."""
BASE = TOP + BAR_HEIGHT
"""Height coordinate of the base line of the bars, downwards, SVG units."""
LABEL_HEIGHT = 22
"""Height of the labels of the axis, SVG units."""
BINS_PER_BAR = 4
"""Number of bins drawn as one bar: five bars per power of ten, or 25 of the quality."""
LOWEST_BAR_GAP = 0.5
"""Distance of the bar for values below all bins, in bar widths."""
LABEL_DISTANCE = 32
"""Smallest distance of a label from the label of the lowest bar, SVG units."""
MIN_BARS = 10
"""Minimum number of bars, so that few bars are not huge."""


CHARTED = MEASURES.view(lambda every: (*COMPARED, *MOVEMENTS))
"""Measures that are drawn."""
MARKS = {QUALITY.key: HOLDS}
"""Key of a measure -> value that a dashed line marks."""
HINTS = {QUALITY.key: "; a grasp of the dashed line or more should hold"}
"""Key of a measure -> addition to its explanation."""

_TEXTS = {METRE: words.millimetres, RADIAN: words.degrees}


def hint(measure: Measure) -> str:
    """Return the explanation of a measure and of the mark in its chart."""
    return measure.hint + HINTS.get(measure.key, "")


def value_text(measure: Measure, value: float) -> str:
    """Return a value in SI units as people read it, without its unit."""
    return _TEXTS.get(measure.unit, words.plain)(value)


def statistics_row(measure: Measure, distributions: Mapping[str, Histogram]) -> list[str]:
    """Mean, median, bound that 19 of 20 grasps meet, and worst value; before, and after."""
    cells = []
    for its in _sides(measure, distributions):
        if not its.count:
            cells += [words.NONE] * 4
            continue
        worst = (its.quantile(0.05), its.least) if measure.better == "higher" else (its.quantile(0.95), its.most)
        cells += [value_text(measure, value) for value in (its.mean, its.quantile(0.5), *worst)]
    return cells


def _sides(measure: Measure, distributions: Mapping[str, Histogram]) -> tuple[Histogram, Histogram]:
    """Return the distributions before and after; an empty one before of a measure that is not compared."""
    columns = [measure.columns[entry] for entry in measure.entries.values()]
    after = distributions[columns[-1]]
    return (distributions[columns[0]] if measure.compared else Histogram(after.bins)), after


@dataclass(frozen=True, eq=False)
class _Axis:
    """Horizontal axis: the bars that are drawn, and their places."""

    edges: np.ndarray
    """Edges (bars + 1,) of all bars except the bars for values below and above."""
    scale: str
    """LINEAR or LOGARITHMIC."""
    first: int
    """Index of the leftmost bar."""
    last: int
    """Index of the rightmost bar."""
    lowest: bool
    """Whether values below all bars are drawn too, apart from the others."""

    @staticmethod
    def of(edges: np.ndarray, scale: str, parts: Sequence[np.ndarray]) -> _Axis:
        """Return the axis with the bars that some shares need."""
        most = len(edges) - 2
        used = np.flatnonzero(sum(its[1:-1] for its in parts))
        first, last = (int(used.min()), int(used.max())) if len(used) else (0, 0)
        if scale == LINEAR:
            first, last = 0, most
        while last - first + 1 < min(MIN_BARS, most + 1):
            first, last = max(first - 1, 0), min(last + 1, most)
        return _Axis(edges, scale, first, last, any(its[0] > 0 for its in parts))

    @property
    def step(self) -> float:
        """Width of a bar, SVG units."""
        return (WIDTH - 2 * LEFT) / (self.last - self.first + 1 + (1 + LOWEST_BAR_GAP) * self.lowest)

    @property
    def begin(self) -> float:
        """Left end of the leftmost bar, SVG units."""
        return LEFT + (1 + LOWEST_BAR_GAP) * self.lowest * self.step

    @property
    def places(self) -> list[tuple[float, int]]:
        """Left end of each bar, and index of the share that it shows."""
        bars = range(self.first, self.last + 1)
        return [(LEFT, 0)] * self.lowest + [(self.begin + (k - self.first) * self.step, k + 1) for k in bars]

    def at(self, value: float) -> float:
        """Horizontal position of a value, SVG units."""
        low, high = self.edges[self.first], self.edges[self.last + 1]
        along = (value - low) / (high - low) if self.scale == LINEAR else log10(value / low) / log10(high / low)
        return self.begin + along * self.step * (self.last - self.first + 1)


def chart(measure: Measure, distributions: Mapping[str, Histogram]) -> str:
    """Draw an SVG element: bars of the share of grasps, before behind after; empty where nothing was measured."""
    before, after = _sides(measure, distributions)
    if not before.count and not after.count:
        return ""
    parts = [its.shares(BINS_PER_BAR) for its in (before, after)]
    for its in parts:
        # Values above the bins are drawn in the last one.
        its[-2] += its[-1]
    axis = _Axis.of(after.bins.edges[::BINS_PER_BAR], after.bins.scale, parts)
    label = escape(f"distribution of {measure.title}")
    drawn = "".join([*_bars(axis, parts), *_scale(axis, measure), *_tooltips(axis, measure, parts)])
    return (
        f'<svg class="bars" viewBox="0 0 {WIDTH} {BASE + LABEL_HEIGHT}" role="img" aria-label="{label}">{drawn}</svg>'
    )


def _bars(axis: _Axis, parts: Sequence[np.ndarray]) -> Iterator[str]:
    """Draw all bars, scaled to the height of the highest."""
    highest = max(its[k] for its in parts for _, k in axis.places)
    for name, its, inset in (("before", parts[0], 0.04), ("after", parts[1], 0.2)):
        for x, k in axis.places:
            if its[k] > 0:
                height = BAR_HEIGHT * its[k] / highest
                yield (
                    f'<rect class="{name}" x="{x + inset * axis.step:.1f}" y="{BASE - height:.1f}" '
                    f'width="{(1 - 2 * inset) * axis.step:.1f}" height="{height:.1f}"/>'
                )


def _tooltips(axis: _Axis, measure: Measure, parts: Sequence[np.ndarray]) -> Iterator[str]:
    """Draw the tooltip of each bar."""
    for x, k in axis.places:
        text = escape(f"{_range_text(measure, axis.edges, k)}: {_shares_text(measure, parts, k)}")
        yield (
            f'<rect class="over" x="{x:.1f}" y="{TOP}" width="{axis.step:.1f}" height="{BAR_HEIGHT}">'
            f"<title>{text}</title></rect>"
        )


def _scale(axis: _Axis, measure: Measure) -> Iterator[str]:
    """Draw the line below the bars with its labels, and the line of the marked value."""
    yield f'<line class="axis" x1="{LEFT}" x2="{WIDTH - LEFT}" y1="{BASE}" y2="{BASE}"/>'
    for value, text in _marks(measure, axis.edges[axis.first], axis.edges[axis.last + 1], axis.scale):
        x = axis.at(value)
        yield f'<line class="axis" x1="{x:.1f}" x2="{x:.1f}" y1="{BASE}" y2="{BASE + 4}"/>'
        # No label overlaps that of the lowest bar.
        if not axis.lowest or x > LEFT + axis.step / 2 + LABEL_DISTANCE:
            anchor = "end" if x > WIDTH - 20 else "start" if x < 12 else "middle"
            yield f'<text x="{x:.1f}" y="{BASE + 16}" text-anchor="{anchor}">{escape(text)}</text>'
    if axis.lowest:
        yield f'<text x="{LEFT + axis.step / 2:.1f}" y="{BASE + 16}" text-anchor="middle">~0</text>'
    if measure.key in MARKS:
        x = axis.at(MARKS[measure.key])
        yield f'<line class="mark" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP - 6}" y2="{BASE}"/>'


def _marks(measure: Measure, low: float, high: float, scale: str) -> Sequence[tuple[float, str]]:
    """Values of the axis with their labels: powers of ten in the unit that people read."""
    if scale == LINEAR:
        return [(low + (high - low) * k / 4, f"{low + (high - low) * k / 4:g}") for k in range(5)]
    unit, symbol = 1.0 / measure.unit.factor, measure.unit.symbol
    found = []
    for power in range(floor(log10(low / unit)), floor(log10(high / unit)) + 2):
        value = 10.0**power * unit
        if low * 0.999 <= value <= high * 1.001:
            text = f"{10.0**power:g}" if -3 <= power <= 4 else f"1e{power}"
            text = words.axis_length(value) if measure.unit == METRE else f"{text}{symbol}"
            found.append((value, text if power % 2 == 0 or high / low < 1e4 else ""))
    return found


def _range_text(measure: Measure, edges: np.ndarray, at: int) -> str:
    """Text for the range of values of a bar."""
    if at == 0:
        return f"below {value_text(measure, edges[0])} {measure.unit.symbol}".rstrip()
    last = at == len(edges) - 1 and measure.better != "higher"
    high = " or more" if last else f" to {value_text(measure, edges[at])}"
    return f"{value_text(measure, edges[at - 1])}{high} {measure.unit.symbol}".rstrip()


def _shares_text(measure: Measure, parts: Sequence[np.ndarray], at: int) -> str:
    before, after = (f"{100 * its[at]:.1f} %" for its in parts)
    return f"{before} before, {after} after" if measure.compared else after
