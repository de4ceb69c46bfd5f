"""HTML reports of benchmarks and batches: one file each, without external resources."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from grasp_refine_apps.report.panels import stylesheet

TEMPLATE = "page.html.jinja"
STYLE = "page.css"
"""Style sheet shared by all pages."""


@dataclass(frozen=True)
class Column:
    """Column of a table."""

    name: str
    """Heading."""
    hint: str
    """Description."""
    words: Callable[[dict[str, Any]], str]
    """Formatter of the cell, given its row."""


def rendered(package: str, **values: Any) -> str:
    """Render a package's template with the colours of the panels, `STYLE` as `style`, and these values."""
    import jinja2

    light, dark = stylesheet()
    text = (files(package) / TEMPLATE).read_text(encoding="utf-8")
    style = (files(__package__) / STYLE).read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    return environment.from_string(text).render(light=light, dark=dark, style=style, **values)
