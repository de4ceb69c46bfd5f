"""The HTML reports of benchmarks: one file, and nothing from outside."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from grasp_refine_apps.report.panels import stylesheet

TEMPLATE = "page.html.jinja"
STYLE = "page.css"
"""What pages of all apps have in common."""


@dataclass(frozen=True)
class Column:
    """Something of each row of a table."""

    name: str
    """Its head."""
    hint: str
    """What it is, in words."""
    words: Callable[[dict[str, Any]], str]
    """How it is shown."""


def rendered(package: str, **values: Any) -> str:
    """The page of a package's template, with the colours of the panels, `STYLE` as `style`, and these values."""
    import jinja2

    light, dark = stylesheet()
    text = (files(package) / TEMPLATE).read_text(encoding="utf-8")
    style = (files(__package__) / STYLE).read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    return environment.from_string(text).render(light=light, dark=dark, style=style, **values)
