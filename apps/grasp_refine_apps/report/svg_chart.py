"""Charts by matplotlib as SVG elements in the colours of the page; equal input gives equal bytes."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

from grasp_refine_apps.report.html_page import COLORS, PLAIN

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

INK, MUTED, RULE, PAGE = (PLAIN[name][0] for name in ("ink", "muted", "line", "page"))
"""Colours of text, side remarks, rules and the page."""

_TIP = "tip:"
"""Prefix of the identifiers of artists with a tooltip."""


@dataclass
class SvgChart:
    """A figure, and its SVG element once it is drawn."""

    figure: Figure
    """The figure to draw in."""
    svg: str = ""
    """The SVG element; empty while the figure is drawn."""


@contextmanager
def svg_chart(title: str, width_in: float, height_in: float, *, look: str = "chart") -> Iterator[SvgChart]:
    """Yield a chart with an empty figure to draw in; afterwards it has its SVG element.

    Args:
        title: Title for screen readers.
        width_in: Width in inches; the page scales it.
        height_in: Height in inches.
        look: Class of the element in the style sheet.
    """
    import matplotlib
    from matplotlib.figure import Figure

    settings: dict[Any, Any] = {
        "svg.fonttype": "none",
        "svg.hashsalt": f"grasp-refine {title}",
        "font.family": ["DejaVu Sans"],
        "font.size": 8.5,
        "text.color": INK,
        "axes.labelcolor": INK,
        "axes.edgecolor": MUTED,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.facecolor": "none",
        "figure.facecolor": "none",
        "legend.frameon": False,
        "xtick.color": MUTED,
        "ytick.color": MUTED,
        "grid.color": RULE,
    }
    with matplotlib.rc_context(settings):
        chart = SvgChart(Figure(figsize=(width_in, height_in), layout="constrained"))
        yield chart
        out = io.StringIO()
        chart.figure.savefig(out, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    chart.svg = _inlined(out.getvalue(), title, look)


def add_tooltip(artist: Artist, text: str) -> None:
    """Show a text where the pointer is over an artist."""
    artist.set_gid(_TIP + text)


def _inlined(svg: str, title: str, look: str) -> str:
    """Extract the SVG element, at full width, with tooltips and the page's variables for colours."""
    head, body = svg[svg.index("<svg") :].split(">", 1)
    head = re.sub(r' (width|height)="[^"]*"', "", head)
    body = re.sub(rf'<g id="{_TIP}([^"]*)">', r'<g class="tip"><title>\1</title>', body)
    # Names of groups would occur twice on a page with two charts; nothing refers to them.
    body = re.sub(r' id="[A-Za-z0-9]+_\d+"', "", body)
    body = body.replace("font-family: 'DejaVu Sans'", "font-family: inherit").replace("'DejaVu Sans'", "inherit")
    for name, (light, _) in {**{f"c{k}": pair for k, pair in enumerate(COLORS)}, **PLAIN}.items():
        body = body.replace(light, f"var(--{name})")
    return f'{head} class="{look}" role="img" aria-label="{escape(title)}">{body}'
