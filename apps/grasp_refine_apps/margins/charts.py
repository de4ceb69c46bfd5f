"""Charts of margins as SVG in the colours of the page; the same numbers give the same bytes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from math import ceil, floor, log10

import numpy as np

from grasp_refine.results.margins_table import Limit
from grasp_refine.validation.margins.margins import Margins

BAR, GAP, LABELS, SCALE, VALUES = 13, 9, 74, 400, 150
"""Height of a bar and the gap between groups of them, and widths of labels, bars and numbers, SVG units."""
CURVE_WIDTH, CURVE_HEIGHT, LEFT, RIGHT, TOP, BELOW = 320, 130, 34, 12, 8, 22
"""Size of the panel of a curve and its margins, SVG units."""


@dataclass(frozen=True, eq=False)
class Side:
    """Grasps of one file."""

    name: str
    """Name in legends."""
    margins: Margins
    """Their margins."""


def factor_bars(sides: Sequence[Side]) -> str:
    """Draw an SVG element: a bar of the mean probability with its interval, for each trial and side."""
    trials = list(dict.fromkeys(name for side in sides for name in side.margins.trials))
    group = BAR * len(sides) + GAP
    height = group * len(trials) + 20
    width = LABELS + SCALE + VALUES
    drawn = []
    for tick in (0, 25, 50, 75, 100):
        x = LABELS + SCALE * tick / 100
        drawn.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{height - 18}"/>')
        drawn.append(f'<text class="tick" x="{x:.1f}" y="{height - 4}" text-anchor="middle">{tick} %</text>')
    for row, name in enumerate(trials):
        top = row * group + GAP / 2
        middle = top + BAR * len(sides) / 2 + 4
        drawn.append(f'<text x="{LABELS - 8}" y="{middle:.1f}" text-anchor="end">{escape(name)}</text>')
        for k, side in enumerate(sides):
            if name in side.margins.trials:
                drawn += _bar(k, top + k * BAR, f"{side.name}, {name}", *side.margins.mean(name))
    return _svg(width, height, "mean probability of holding by factor", drawn)


def _bar(side: int, top: float, what: str, mean: float, low: float, high: float) -> Iterator[str]:
    """Draw a bar with its whisker and its numbers."""
    middle = top + BAR / 2
    numbers = f"{100 * mean:.1f} % ({100 * low:.1f} to {100 * high:.1f})"
    yield f'<rect class="s{side}" x="{LABELS}" y="{top + 1:.1f}" width="{SCALE * mean:.1f}" height="{BAR - 2}">'
    yield f"<title>{escape(f'{what}: {numbers}')}</title></rect>"
    ends = [LABELS + SCALE * value for value in (low, high)]
    yield f'<line class="whisker" x1="{ends[0]:.1f}" x2="{ends[1]:.1f}" y1="{middle:.1f}" y2="{middle:.1f}"/>'
    for x in ends:
        yield f'<line class="whisker" x1="{x:.1f}" x2="{x:.1f}" y1="{middle - 3:.1f}" y2="{middle + 3:.1f}"/>'
    yield f'<text class="tick" x="{LABELS + SCALE + 12}" y="{middle + 4:.1f}">{numbers}</text>'


def limit_curve(limit: Limit, sides: Sequence[Side]) -> str:
    """Draw an SVG element: the share of the grasps that hold, against friction, force or torque."""
    low, high = limit.range
    width, base = CURVE_WIDTH, TOP + CURVE_HEIGHT

    def across(value: float) -> float:
        return LEFT + (width - LEFT - RIGHT) * log10(value / low) / log10(high / low)

    drawn = []
    for share in (0, 50, 100):
        y = base - CURVE_HEIGHT * share / 100
        drawn.append(f'<line class="grid" x1="{LEFT}" x2="{width - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        drawn.append(f'<text class="tick" x="{LEFT - 5}" y="{y + 4:.1f}" text-anchor="end">{share}</text>')
    for value in _ticks(low, high):
        x = across(value)
        drawn.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{base}" y2="{base + 4}"/>')
        drawn.append(f'<text class="tick" x="{x:.1f}" y="{base + 16}" text-anchor="middle">{value:g}</text>')
    for k, side in enumerate(sides):
        if side.margins.limits is None:
            continue
        values = limit.of(side.margins.limits)
        places = np.geomspace(low, high, 129)
        held = values[:, None] <= places if limit.lower_is_better else values[:, None] >= places
        points = zip(places, held.mean(axis=0), strict=True)
        path = " ".join(f"{across(x):.1f},{base - CURVE_HEIGHT * y:.1f}" for x, y in points)
        drawn.append(f'<polyline class="s{k}" points="{path}"><title>{escape(side.name)}</title></polyline>')
    return _svg(width, base + BELOW, f"share of grasps that hold by {limit.title}", drawn)


def _ticks(low: float, high: float) -> list[float]:
    """Return 1, 2 and 5 times powers of ten within a range."""
    powers = range(floor(log10(low)), ceil(log10(high)) + 1)
    values = [round(digit * 10.0**power, 6) for power in powers for digit in (1, 2, 5)]
    return [value for value in values if low * 0.999 <= value <= high * 1.001]


def _svg(width: int, height: int, label: str, drawn: Sequence[str]) -> str:
    return (
        f'<svg class="margins" viewBox="0 0 {width} {height}" role="img" aria-label="{escape(label)}">'
        f"{''.join(drawn)}</svg>"
    )
