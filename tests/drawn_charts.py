"""Shapes and tooltips of the SVG charts that matplotlib draws for our pages."""

from __future__ import annotations

import re

import numpy as np


def paths(svg: str, style: str) -> list[np.ndarray]:
    """Corners (K, 2) of each path whose style begins so, in points, y downwards."""
    found = re.findall(rf'<path d="([^"]*)"[^>]*style="{re.escape(style)}', svg)
    return [np.array(re.findall(r"[ML] (\S+) (\S+)", each), dtype=float) for each in found]


def bars(svg: str, color: str, *, along: int = 1) -> list[float]:
    """Lengths of the bars of a colour, across (0) or up (1), in parts of the longest of any colour."""
    lengths, every = (
        [float(np.ptp(path[:, along])) for path in paths(svg, style)]
        for style in (f"fill: var(--{color})", "fill: var(--")
    )
    return [length / max(every) for length in lengths]


def tooltips(svg: str) -> list[str]:
    """Texts of the tooltips."""
    return re.findall(r"<title>([^<]*)</title>", svg)
