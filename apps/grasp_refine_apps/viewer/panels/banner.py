"""Banner over the scene: what a picture cannot show, such as that the object is only a stand-in."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import viser

if TYPE_CHECKING:
    from grasp_refine_apps.viewer.model.state import State

STYLE = (
    "position:fixed;left:16px;bottom:16px;max-width:min(34em,60vw);z-index:3;padding:.5em .9em;border-radius:6px;"
    "font:14px/1.4 system-ui,sans-serif;pointer-events:none;"
)
"""Style of the banner; it is fixed to the window, whose left part is the scene."""

COLORS = (
    "color:#4a3000;background:#fff3bf;border:1px solid #e8b800",
    "color:#7d0b26;background:#ffe3e3;border:1px solid #c92a2a",
)
"""Colours of a remark, and of an error."""


class Banner:
    """Text over the scene; empty where there is nothing to report."""

    def __init__(self, gui: viser.GuiApi) -> None:
        """Make the banner, empty."""
        self.html = gui.add_html("", visible=False)

    def draw(self, state: State) -> None:
        """Show a state."""
        text = banner_text(state)
        self.show(text)

    def show(self, text: str, *, bad: bool = False) -> None:
        """Show a text; empty: nothing."""
        content = f'<div{" data-error" * bad} style="{STYLE}{COLORS[bad]}">{escape(text)}</div>' if text else ""
        if self.html.content != content:
            self.html.content = content
            self.html.visible = bool(text)


def banner_text(state: State) -> str:
    """Text of the banner; empty: none."""
    # Its module loads packages, and the first banner is shown before.
    from grasp_refine_apps.viewer.panels.form import plain

    collection, number = state.collection, state.number
    if not state.shown.posed and (why := collection.undrawn(number)):
        count, label = f"{int(collection.posed.sum())} of {len(collection)}", collection.label(number)
        return f"{label} is not drawn: {plain(why)}. Of the open grasps, {count} can be drawn."
    name = collection.group(number).object
    if state.scene.object.rough:
        return (
            f"'{name}' is still to be decomposed into convex pieces: until then, contacts are on its convex hull. "
            "Refinement and tests wait for it."
        )
    if name not in collection.stand_ins:
        return ""
    return (
        f"Stand-in: the grasp is for '{name}', whose mesh is not known; '{state.scene.object.name}' is drawn in its "
        "place. Upload the mesh, named like the object, in Files."
    )
