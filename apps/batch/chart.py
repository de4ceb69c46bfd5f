"""Distributions before and after as SVG that follows the colours of the page; the same counts give the same bytes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from math import degrees, floor, log10

import numpy as np

from grasp_refine.report.verdict import HOLDS

from . import words
from .histogram import LINEAR, Histogram

WIDTH, HIGH, LEFT, TOP = 320, 104, 6, 8
"""Units of the drawing: its width, how high the highest bar is, and what is left free beside and above."""
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


def chart(measure: Measure, distributions: Mapping[str, Histogram]) -> str:
    """An SVG element: bars of the share of grasps, before behind after; empty where nothing was measured."""
    after = distributions[measure.after]
    before = distributions[measure.before] if measure.before else Histogram(after.bins)
    if not before.count and not after.count:
        return ""
    parts = [its.shares(TOGETHER) for its in (before, after)]
    edges = after.bins.edges[::TOGETHER]
    used = np.flatnonzero((parts[0] + parts[1])[1:])
    # What lies above the bins is drawn in the last one.
    first, last = (min(used.min(), len(edges) - 2), min(used.max(), len(edges) - 2)) if len(used) else (0, 0)
    if after.bins.scale == LINEAR:
        first, last = 0, len(edges) - 2
    while last - first + 1 < FEWEST:
        first, last = max(first - 1, 0), min(last + 1, len(edges) - 2)
    for its in parts:
        its[-2] += its[-1]
    lowest = any(its[0] > 0 for its in parts)
    shift = 1 + GAP if lowest else 0.0
    step = (WIDTH - 2 * LEFT) / (last - first + 1 + shift)
    places = [(LEFT, 0)] * lowest + [(LEFT + (shift + k - first) * step, k + 1) for k in range(first, last + 1)]
    highest = max(its[at] for its in parts for _, at in places)
    bars = [
        f'<rect class="{name}" x="{x + inset * step:.1f}" y="{TOP + HIGH * (1 - its[at] / highest):.1f}" '
        f'width="{(1 - 2 * inset) * step:.1f}" height="{HIGH * its[at] / highest:.1f}"/>'
        for name, its, inset in (("before", parts[0], 0.04), ("after", parts[1], 0.2))
        for x, at in places
        if its[at] > 0
    ]
    hovers = [
        f'<rect class="over" x="{x:.1f}" y="{TOP}" width="{step:.1f}" height="{HIGH}"><title>'
        f"{escape(_range(measure, edges, at))}: {_shares(measure, parts, at)}</title></rect>"
        for x, at in places
    ]
    base = TOP + HIGH
    axis = [f'<line class="axis" x1="{LEFT}" x2="{WIDTH - LEFT}" y1="{base}" y2="{base}"/>']
    begin = LEFT + shift * step
    for value, text in _marks(measure, edges[first], edges[last + 1], after.bins.scale):
        x = begin + _along(value, edges[first], edges[last + 1], after.bins.scale) * step * (last - first + 1)
        axis.append(f'<line class="axis" x1="{x:.1f}" x2="{x:.1f}" y1="{base}" y2="{base + 4}"/>')
        # Nothing is written over what the lowest bar is called.
        if not lowest or x > LEFT + step / 2 + CLEAR:
            anchor = "end" if x > WIDTH - 20 else "start" if x < 12 else "middle"
            axis.append(f'<text x="{x:.1f}" y="{base + 16}" text-anchor="{anchor}">{escape(text)}</text>')
    if lowest:
        axis.append(f'<text x="{LEFT + step / 2:.1f}" y="{base + 16}" text-anchor="middle">~0</text>')
    if measure.mark is not None:
        x = begin + _along(measure.mark, edges[first], edges[last + 1], after.bins.scale) * step * (last - first + 1)
        axis.append(f'<line class="mark" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP - 6}" y2="{base}"/>')
    label = escape(f"distribution of {measure.title}")
    return (
        f'<svg class="bars" viewBox="0 0 {WIDTH} {TOP + HIGH + BELOW}" role="img" aria-label="{label}">'
        f"{''.join(bars + axis + hovers)}</svg>"
    )


def _along(value: float, low: float, high: float, scale: str) -> float:
    """Where a value lies between two others, from 0 to 1."""
    return (value - low) / (high - low) if scale == LINEAR else log10(value / low) / log10(high / low)


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
