"""Histogram of a measure as HTML: all grasps pale, listed ones dark; a brush over it filters the list."""

from __future__ import annotations

from html import escape

import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine_apps.viewer.model.columns import Column

NUM_BINS, HEIGHT_PX = 32, 46
"""Number of bars, and height of the tallest one in pixels."""

STYLE = """<style>
.gr-hist{font:11px/1.3 system-ui,sans-serif;margin:0 1em .6em}
.gr-hist svg{width:100%;height:48px;display:block;cursor:col-resize;touch-action:none;overflow:visible}
.gr-hist .gr-all{fill:rgba(128,128,128,.4)}.gr-hist .gr-listed{fill:#1971c2}
.gr-hist .gr-range{fill:rgba(25,113,194,.2);stroke:#1971c2;stroke-width:.5}
.gr-hist div{display:flex;justify-content:space-between}
</style>"""
"""Style sheet of the histogram."""


def histogram_html(column: Column, listed: Int[np.ndarray, " M"], range_: tuple[float, float] | None) -> str:
    """Return the histogram of a numeric column.

    Args:
        column: The measure.
        listed: Numbers of the grasps that are listed.
        range_: Lowest and highest listed value, SI units; None: all.
    """
    known = column.values[column.known]
    if column.is_text or not len(known):
        return f'{STYLE}<div class="gr-hist">not known of any grasp: press Measure all, or refine some</div>'
    low, high = limits(column)
    edges = np.linspace(low, high, NUM_BINS + 1)
    every, _ = np.histogram(known, edges)
    some, _ = np.histogram(column.values[listed][column.known[listed]], edges)
    scale = HEIGHT_PX / max(int(every.max()), 1)
    bars = "".join(
        f'<rect class="{name}" x="{k}" width=".9" y="{HEIGHT_PX - scale * count:.1f}" height="{scale * count:.1f}"/>'
        for name, counts in (("gr-all", every), ("gr-listed", some))
        for k, count in enumerate(counts.tolist())
        if count
    )
    brushed = ""
    if range_ is not None:
        left, right = (np.clip(NUM_BINS * (np.array(range_) - low) / (high - low), 0, NUM_BINS)).tolist()
        brushed = f'<rect class="gr-range" x="{left:.2f}" width="{max(right - left, 0.1):.2f}" y="0" height="48"/>'
    ends = [format(value * column.factor, column.format) for value in (low, high)]
    hint = "drag to list a range" if range_ is None else "click to list all"
    return (
        f'{STYLE}<div class="gr-hist"><svg data-brush="{escape(column.key)}" viewBox="0 0 {NUM_BINS} 48" '
        f'preserveAspectRatio="none" role="img" aria-label="histogram of {escape(column.title)}">{brushed}{bars}</svg>'
        f"<div><span>{ends[0]}</span><span>{hint}</span><span>{ends[1]}</span></div></div>"
    )


def limits(column: Column) -> Float[np.ndarray, " 2"]:
    """Return lowest and highest value of a column (2,), different also where all are equal, SI units."""
    known = column.values[column.known]
    low, high = float(known.min()), float(known.max())
    return np.array([low, high if high > low else low + max(abs(low), 1e-6)])


def brushed_range(column: Column, left: float, right: float) -> tuple[float, float] | None:
    """Return the range of values between two places of the histogram, 0 left and 1 right; None: a click, no range."""
    left, right = sorted((min(max(left, 0.0), 1.0), min(max(right, 0.0), 1.0)))
    if right - left < 0.5 / NUM_BINS or not column.known.any():
        return None
    low, high = limits(column)
    return float(low + left * (high - low)), float(low + right * (high - low))
