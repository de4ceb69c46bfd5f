"""HTML reports of benchmarks and batches: one file each, without external resources."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

TEMPLATE = "page.html.jinja"
STYLE = "page.css"
"""Style sheet shared by all pages."""
MACROS = "macros.html.jinja"
"""Macros that all templates can use."""


COLORS = (
    ("#0067a5", "#62b8f2"),
    ("#c2410c", "#f58a50"),
    ("#047857", "#34c99a"),
    ("#a23b7d", "#e992c6"),
    ("#97650a", "#e8b33d"),
    ("#24292f", "#e6e9ed"),
    ("#7a828e", "#949daa"),
    ("#6b3fc4", "#b49bf5"),
)
"""Colours of lines on a light and on a dark page, chosen to differ in brightness too."""
PLAIN = {"ink": ("#1b2430", "#e3e8ee"), "muted": ("#5b6676", "#9aa6b5"), "line": ("#d9dee6", "#343d49")}
PLAIN["page"] = ("#fffffe", "#14181d")
"""Text, side remarks, rules and the page itself."""


def stylesheet() -> tuple[str, str]:
    """Declarations of all colours for a light and for a dark page."""
    pairs = {**{f"c{k}": pair for k, pair in enumerate(COLORS)}, **PLAIN}
    light, dark = (" ".join(f"--{name}: {pair[mode]};" for name, pair in pairs.items()) for mode in (0, 1))
    return light, dark


def rendered(package: str, **values: Any) -> str:
    """Render a package's template with the colours of the panels, `STYLE` as `style`, and these values."""
    import jinja2

    light, dark = stylesheet()
    text = (files(package) / TEMPLATE).read_text(encoding="utf-8")
    style, macros = ((files(__package__) / name).read_text(encoding="utf-8") for name in (STYLE, MACROS))
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    return environment.from_string(macros + text).render(light=light, dark=dark, style=style, **values)
