"""Console for people to read: a terminal, at most 100 columns wide, or a pipe."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator

from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderableType, RenderHook
from rich.segment import Segment
from rich.text import Text

from grasp_refine.core.errors import visible
from grasp_refine_apps.report.command_line import in_options

MIN_COLUMNS, MAX_COLUMNS = 80, 100
"""Range of the width, columns: narrower tables would lose their numbers, and longer lines are hard to read."""


class _Visible:
    """Renderable whose text cannot control a terminal: all but printable characters and line ends is escaped."""

    def __init__(self, shown: RenderableType) -> None:
        self._shown = shown

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Segment]:
        for segment in console.render(self._shown, options):
            clean = segment.control or segment.text.isprintable() or segment.text == "\n"
            yield segment if clean else Segment("\n".join(map(visible, segment.text.split("\n"))), segment.style)


class _EscapeControls(RenderHook):
    """Hook that escapes control characters: printed text may hold names from other people's files."""

    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        return [_Visible(shown) for shown in renderables]


class _Console(Console):
    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render with options for the fields that the library names."""
        if isinstance(renderable, Text) and "`" in renderable.plain:
            renderable = renderable.copy()
            renderable.plain = in_options(renderable.plain)
        return super().render(in_options(renderable) if isinstance(renderable, str) else renderable, options)

    def on_broken_pipe(self) -> None:
        """Let the error through; rich would end the program with a code that means something else here."""
        raise  # noqa: PLE0704


def screen(*, stderr: bool = False) -> Console:
    r"""Return a console as wide as the terminal, but not wider than is good to read; plain text where there is none.

    Names of files may come from others: control characters are printed as escapes, such as \x1b.
    """
    columns = shutil.get_terminal_size((MAX_COLUMNS, 24)).columns
    width = max(MIN_COLUMNS, min(MAX_COLUMNS, columns))
    console = _Console(width=width, stderr=stderr, highlight=False, emoji=False)
    console.push_render_hook(_EscapeControls())
    return console
