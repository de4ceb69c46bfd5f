"""The whole panel: a heading with what the shown grasp is worth, and tabs."""

from __future__ import annotations

import html
from typing import Any

import numpy as np
import viser

from grasp_refine_apps.viewer.colors import distance_legend
from grasp_refine_apps.viewer.controller import Controller
from grasp_refine_apps.viewer.panels.browse_panel import BrowsePanel
from grasp_refine_apps.viewer.panels.display_panel import DisplayPanel
from grasp_refine_apps.viewer.panels.edit_panel import EditPanel
from grasp_refine_apps.viewer.panels.export_panel import ExportPanel
from grasp_refine_apps.viewer.panels.refine_panel import RefinePanel
from grasp_refine_apps.viewer.panels.validate_panel import ValidatePanel
from grasp_refine_apps.viewer.state import State
from grasp_refine_apps.viewer.view import View

PANELS = (
    ("Refine", RefinePanel),
    ("Steer", EditPanel),
    ("Prove", ValidatePanel),
    ("Browse", BrowsePanel),
    ("Files", ExportPanel),
    ("View", DisplayPanel),
)
"""What the tabs are called, and what is in them."""


class PagePanel:
    """Heading and tabs; draws the heading, and tells what is to be told."""

    def __init__(self, server: viser.ViserServer, controller: Controller, view: View) -> None:
        """Make all widgets."""
        self._server, self._view = server, view
        self._heading = server.gui.add_html("")
        self._told = 0
        tabs = server.gui.add_tab_group()
        self.panels: list[Any] = []
        """The panels in the tabs; each draws for itself."""
        for title, kind in PANELS:
            with tabs.add_tab(title):
                self.panels.append(kind(server, controller))

    def close(self) -> None:
        """End what panels do by themselves, such as films."""
        for panel in self.panels:
            if hasattr(panel, "close"):
                panel.close()

    def draw(self, state: State) -> None:
        """Show a state."""
        text = _heading(state, self._view)
        if self._heading.content != text:
            self._heading.content = text
        notice = state.notice
        clients = self._server.get_clients().values()
        # What is said before anybody looks is told to the first who does.
        if notice is not None and notice.number != self._told and clients:
            self._told = notice.number
            for client in clients:
                client.add_notification(
                    "This did not work" if notice.bad else "grasp-refine",
                    notice.text,
                    color="red" if notice.bad else "blue",
                    auto_close_seconds=None if notice.bad else 8.0,
                )


def _heading(state: State, view: View) -> str:
    """What is shown, and what it is worth."""
    collection, found = state.collection, view.contacts
    name = f"{collection.hand.name} on {collection.label(state.number)}"
    lines = [f"<b>{html.escape(name)}</b>"]
    if state.motion is not None:
        lines.append(html.escape(state.motion.text(state.motion_frame)))
    elif found is not None:
        error = f"contact error {1e3 * found.contact_error:.2f} mm"
        error = "nothing near enough to touch" if np.isnan(found.contact_error) else error
        lines.append(f"{error} &nbsp; penetration {1e3 * found.penetration:.2f} mm")
    style = "padding:0.3em 1em;line-height:1.5;font-size:0.9em;overflow-wrap:anywhere"
    return f'<div style="{style}">{"<br>".join(lines)}{SCALE}</div>'


def _scale() -> str:
    """The colours of distances, in one line."""
    swatch = "display:inline-block;width:0.8em;height:0.8em;border-radius:50%;vertical-align:-0.05em"
    parts = [
        f'<span><span style="{swatch};background:rgb{color}"></span> {text}</span>' for text, color in distance_legend()
    ]
    return (
        '<div style="display:flex;justify-content:space-between;font-size:0.78em;opacity:0.85;margin-top:0.2em">'
        f"{''.join(parts)}</div>"
    )


SCALE = _scale()
"""What the colours of points and lines between links and object mean."""
