"""Tables as text for `print`, and as HTML for notebooks."""

from __future__ import annotations

import io

from rich.console import Console, RenderableType

LINE_WIDTH = 100
"""Width of a line in characters."""


def text_of(table: RenderableType) -> str:
    """Return a table as plain text."""
    console = Console(file=io.StringIO(), width=LINE_WIDTH, color_system=None, legacy_windows=False)
    console.print(table)
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]  # a StringIO
    return "\n".join(line.rstrip() for line in lines).strip("\n")


def html_of(table: RenderableType) -> str:
    """Return a table as a fragment of HTML with its colours inline."""
    console = Console(file=io.StringIO(), width=LINE_WIDTH, record=True, legacy_windows=False, force_jupyter=False)
    console.print(table)
    return console.export_html(inline_styles=True, code_format='<pre style="line-height: 1.2">{code}</pre>')
