"""Where people read: the terminal, at most 100 columns wide, or a pipe."""

from __future__ import annotations

import shutil

from rich.console import Console

NARROWEST, WIDEST = 80, 100
"""Narrower tables would lose their numbers, and longer lines are hard to read."""


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Let the error through; rich would end the program with a code that means something else here."""
        raise  # noqa: PLE0704


def screen(*, stderr: bool = False) -> Console:
    """A console as wide as the terminal, but not wider than is good to read; plain text where there is none."""
    columns = shutil.get_terminal_size((WIDEST, 24)).columns
    width = max(NARROWEST, min(WIDEST, columns))
    return _Console(width=width, stderr=stderr, highlight=False, emoji=False)
