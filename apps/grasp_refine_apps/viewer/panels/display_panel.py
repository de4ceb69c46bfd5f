"""Tab with the display options of the scene."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, get_args, get_type_hints

import viser

from grasp_refine_apps.viewer.controller import Controller
from grasp_refine_apps.viewer.parts import DEEP_COLOR, FORCE_COLOR, GHOST_COLOR, TARGET_COLOR
from grasp_refine_apps.viewer.state import Showing, State

LABELS = {
    "hand": ("Hand", "Its visual meshes, or the convex pieces that collide."),
    "object": ("Object", "Its surface, its convex pieces in colours, or its edges."),
    "transparent": ("See through", "Make the object transparent, to show contacts behind it."),
    "ghost": ("Input hand", "A pale copy of the hand before refinement."),
    "contacts": ("Contacts", "Points where links and object are nearest or deepest, and lines between them."),
    "forces": ("Forces", "The contact forces that balance best, and friction cones."),
    "frames": ("Frames", "Axes of the base link and of the object: x red, y green, z blue."),
    "table": ("Table", "The table, where there is one."),
}
"""Field of `Showing` -> label and hint."""


class DisplayPanel:
    """Display options, and the legend."""

    def __init__(self, server: viser.ViserServer, controller: Controller) -> None:
        """Make the widgets."""
        self._widgets: dict[str, Any] = {}
        gui, hints = server.gui, get_type_hints(Showing)
        for field in fields(Showing):
            label, hint = LABELS[field.name]
            if hints[field.name] is bool:
                widget: Any = gui.add_checkbox(label, field.default is True, hint=hint)
            else:
                widget = gui.add_dropdown(label, get_args(hints[field.name]), hint=hint)

            @widget.on_update
            def _(event: Any, name: str = field.name) -> None:
                if event.client is not None:
                    controller.set_showing(**{name: self._widgets[name].value})

            self._widgets[field.name] = widget
        gui.add_html(_legend())

    def draw(self, state: State) -> None:
        """Show a state."""
        for name, widget in self._widgets.items():
            value = getattr(state.showing, name)
            value = value and state.scene.table is not None if name == "table" else value
            if widget.value != value:
                widget.value = value
        self._widgets["table"].disabled = state.scene.table is None


def _legend() -> str:
    rows = [
        ((242, 184, 102), "links that are meant to touch"),
        ((220, 90, 80), "links that are inside the object"),
        (GHOST_COLOR, "the input hand"),
        (TARGET_COLOR, "target: where a link should touch"),
        (FORCE_COLOR, "contact forces, in their friction cones"),
        (DEEP_COLOR, "the push in a simulation"),
    ]
    swatch = "display:inline-block;width:0.9em;height:0.9em;border-radius:50%;margin-right:0.5em;vertical-align:middle"
    lines = "".join(f'<div><span style="{swatch};background:rgb{color}"></span>{text}</div>' for color, text in rows)
    return f'<div style="padding:0.2em 1em 0.6em;font-size:0.85em;line-height:1.6">{lines}</div>'
