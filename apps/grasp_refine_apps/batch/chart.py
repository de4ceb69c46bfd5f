"""Distributions before and after as SVG that follows the colours of the page; the same counts give the same bytes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from math import degrees, floor, log10

import numpy as np

from grasp_refine.results.verdict import HOLDS
from grasp_refine_apps.batch import words
from grasp_refine_apps.batch.histogram import LINEAR, Histogram

WIDTH, HIGH, LEFT, TOP = 320, 104, 6, 8
"""Units of the drawing: its width, how high the highest bar is, and what is left free beside and above."""
BASE = TOP + HIGH
"""How far down the bars stand."""
BELOW = 22
"""Room for the marks of the axis."""
TOGETHER = 4
"""So many bins are drawn as one: five to a power of ten, or 25 of the quality."""
GAP = 0.5
"""The bar of what lies below all bins stands so many bars apart."""
CLEAR = 32
"""Nothing is written nearer to what is written below the lowest bar."""
FEWEST = 10
"""Bars that there is room for at least, so that few are not huge."""


@dataclass(frozen=True)
class Measure:
    """What is measured of grasps, and how people read it."""

    title: str
    """What it is."""
    hint: str
    """The same in a sentence."""
    before: str | None
    """Its column before; None: it is of refined grasps only."""
    after: str
    """Its column after."""
    words: Callable[[float], str]
    """A value as it is read."""
    unit: str
    """Its unit there."""
    bad: bool = True
    """Whether large values are bad ones."""
    mark: float | None = None
    """A value to be marked."""

    def row(self, distributions: Mapping[str, Histogram]) -> list[str]:
        """Mean, median, the value that 19 of 20 do not fall behind, and the worst; before, and after."""
        cells = []
        for column in (self.before, self.after):
            its = distributions[column] if column else None
            if its is None or not its.count:
                cells += [words.NONE] * 4
                continue
            worst = (its.quantile(0.95), its.most) if self.bad else (its.quantile(0.05), its.least)
            cells += [self.words(value) for value in (its.mean, its.quantile(0.5), *worst)]
        return cells


def _lengths(title: str, hint: str, name: str) -> Measure:
    return Measure(title, hint, f"{name}_before_m", f"{name}_after_m", words.millimetres, "mm")


MEASURES = (
    Measure(
        "quality",
        "1 / (1 + score), from 0 to 1; a grasp of the dashed line or more should hold",
        "quality_before",
        "quality_after",
        words.plain,
        "",
        bad=False,
        mark=HOLDS,
    ),
    Measure(
        "wrench residual",
        "what the best contact forces leave unbalanced, without unit",
        "wrench_residual_before",
        "wrench_residual_after",
        words.plain,
        "",
    ),
    _lengths("contact error", "the worst gap, or miss of a target, of the links that should touch", "contact_error"),
    _lengths("penetration", "the deepest of any link in the object", "penetration"),
    _lengths("self-penetration", "the deepest of links in each other", "self_penetration"),
)
"""What is told before and after."""
MOVED = (
    Measure("hand moved", "how far its base link is from where it came", None, "moved_palm_m", words.millimetres, "mm"),
    Measure("hand turned", "by how much its base link turned", None, "moved_palm_rad", words.degrees, "°"),
    Measure("joints moved", "the one that moved most", None, "moved_joints_rad", words.degrees, "°"),
)
"""What is told after only."""


@dataclass(frozen=True, eq=False)
class _Axis:
    """Which bars are drawn where."""

    edges: np.ndarray
    """Edges of all bars but those of what lies below and above."""
    scale: str
    """How they go on."""
    first: int
    """The leftmost bar,"""
    last: int
    """and the rightmost one."""
    lowest: bool
    """Whether what lies below is drawn, too, apart from the others."""

    @staticmethod
    def of(edges: np.ndarray, scale: str, parts: Sequence[np.ndarray]) -> _Axis:
        """The bars that are needed for some shares."""
        most = len(edges) - 2
        used = np.flatnonzero(sum(its[1:-1] for its in parts))
        first, last = (int(used.min()), int(used.max())) if len(used) else (0, 0)
        if scale == LINEAR:
            first, last = 0, most
        while last - first + 1 < min(FEWEST, most + 1):
            first, last = max(first - 1, 0), min(last + 1, most)
        return _Axis(edges, scale, first, last, any(its[0] > 0 for its in parts))

    @property
    def step(self) -> float:
        """Room of a bar."""
        return (WIDTH - 2 * LEFT) / (self.last - self.first + 1 + (1 + GAP) * self.lowest)

    @property
    def begin(self) -> float:
        """Where the leftmost bar begins."""
        return LEFT + (1 + GAP) * self.lowest * self.step

    @property
    def places(self) -> list[tuple[float, int]]:
        """Where each bar begins, and which share it shows."""
        bars = range(self.first, self.last + 1)
        return [(LEFT, 0)] * self.lowest + [(self.begin + (k - self.first) * self.step, k + 1) for k in bars]

    def at(self, value: float) -> float:
        """Where a value is."""
        low, high = self.edges[self.first], self.edges[self.last + 1]
        along = (value - low) / (high - low) if self.scale == LINEAR else log10(value / low) / log10(high / low)
        return self.begin + along * self.step * (self.last - self.first + 1)


def chart(measure: Measure, distributions: Mapping[str, Histogram]) -> str:
    """An SVG element: bars of the share of grasps, before behind after; empty where nothing was measured."""
    after = distributions[measure.after]
    before = distributions[measure.before] if measure.before else Histogram(after.bins)
    if not before.count and not after.count:
        return ""
    parts = [its.shares(TOGETHER) for its in (before, after)]
    for its in parts:
        # What lies above the bins is drawn in the last one.
        its[-2] += its[-1]
    axis = _Axis.of(after.bins.edges[::TOGETHER], after.bins.scale, parts)
    label = escape(f"distribution of {measure.title}")
    drawn = "".join([*_bars(axis, parts), *_scale(axis, measure), *_hovers(axis, measure, parts)])
    return f'<svg class="bars" viewBox="0 0 {WIDTH} {BASE + BELOW}" role="img" aria-label="{label}">{drawn}</svg>'


def _bars(axis: _Axis, parts: Sequence[np.ndarray]) -> Iterator[str]:
    """All bars, the highest as high as there is room."""
    highest = max(its[k] for its in parts for _, k in axis.places)
    for name, its, inset in (("before", parts[0], 0.04), ("after", parts[1], 0.2)):
        for x, k in axis.places:
            if its[k] > 0:
                height = HIGH * its[k] / highest
                yield (
                    f'<rect class="{name}" x="{x + inset * axis.step:.1f}" y="{BASE - height:.1f}" '
                    f'width="{(1 - 2 * inset) * axis.step:.1f}" height="{height:.1f}"/>'
                )


def _hovers(axis: _Axis, measure: Measure, parts: Sequence[np.ndarray]) -> Iterator[str]:
    """What is told of each bar below the pointer."""
    for x, k in axis.places:
        told = escape(f"{_range(measure, axis.edges, k)}: {_shares(measure, parts, k)}")
        yield (
            f'<rect class="over" x="{x:.1f}" y="{TOP}" width="{axis.step:.1f}" height="{HIGH}">'
            f"<title>{told}</title></rect>"
        )


def _scale(axis: _Axis, measure: Measure) -> Iterator[str]:
    """The line below the bars, with what is written there, and the value that is marked."""
    yield f'<line class="axis" x1="{LEFT}" x2="{WIDTH - LEFT}" y1="{BASE}" y2="{BASE}"/>'
    for value, text in _marks(measure, axis.edges[axis.first], axis.edges[axis.last + 1], axis.scale):
        x = axis.at(value)
        yield f'<line class="axis" x1="{x:.1f}" x2="{x:.1f}" y1="{BASE}" y2="{BASE + 4}"/>'
        # Nothing is written over what the lowest bar is called.
        if not axis.lowest or x > LEFT + axis.step / 2 + CLEAR:
            anchor = "end" if x > WIDTH - 20 else "start" if x < 12 else "middle"
            yield f'<text x="{x:.1f}" y="{BASE + 16}" text-anchor="{anchor}">{escape(text)}</text>'
    if axis.lowest:
        yield f'<text x="{LEFT + axis.step / 2:.1f}" y="{BASE + 16}" text-anchor="middle">~0</text>'
    if measure.mark is not None:
        x = axis.at(measure.mark)
        yield f'<line class="mark" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP - 6}" y2="{BASE}"/>'


def _marks(measure: Measure, low: float, high: float, scale: str) -> Sequence[tuple[float, str]]:
    """Values of the axis, with what is written there: powers of ten in the unit that people read."""
    if scale == LINEAR:
        return [(low + (high - low) * k / 4, f"{low + (high - low) * k / 4:g}") for k in range(5)]
    unit = {"mm": 1e-3, "°": 1.0 / degrees(1.0), "s": 1.0}.get(measure.unit, 1.0)
    found = []
    for power in range(floor(log10(low / unit)), floor(log10(high / unit)) + 2):
        value = 10.0**power * unit
        if low * 0.999 <= value <= high * 1.001:
            text = f"{10.0**power:g}" if -3 <= power <= 4 else f"1e{power}"
            text = words.micro(value) if measure.unit == "mm" else f"{text}{measure.unit}"
            found.append((value, text if power % 2 == 0 or high / low < 1e4 else ""))
    return found


def _range(measure: Measure, edges: np.ndarray, at: int) -> str:
    """The values of a bar."""
    if at == 0:
        return f"below {measure.words(edges[0])} {measure.unit}".rstrip()
    last = at == len(edges) - 1 and measure.bad
    high = " or more" if last else f" to {measure.words(edges[at])}"
    return f"{measure.words(edges[at - 1])}{high} {measure.unit}".rstrip()


def _shares(measure: Measure, parts: Sequence[np.ndarray], at: int) -> str:
    before, after = (f"{100 * its[at]:.1f} %" for its in parts)
    return f"{before} before, {after} after" if measure.before else after
