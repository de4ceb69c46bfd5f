"""Buttons beside each other: viser puts each on its own line."""

from __future__ import annotations

from collections.abc import Sequence

import viser


def in_a_row(gui: viser.GuiApi, buttons: Sequence[viser.GuiButtonHandle]) -> None:
    """Put buttons that follow each other on one line, equally wide.

    viser 1.1 has no such layout, but gives each button the id of its handle, which a style sheet can name. Should
    that ever change, buttons are below each other again.
    """
    width = f"calc((100% - 1.25rem) / {len(buttons)})"
    rules = []
    for i, button in enumerate(buttons):
        left, right = ("0.625rem" if i == end else "0" for end in (0, len(buttons) - 1))
        rules.append(
            f'div:has(> button[id="{button._impl.uuid}"]) {{ display: inline-block; width: {width}; '
            f"margin-inline: {left} {right} !important; padding-left: {'0' if i == 0 else '0.3em'} }}"
        )
    gui.add_html(f"<style>{' '.join(rules)}</style>")
