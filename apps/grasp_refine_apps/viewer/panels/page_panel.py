"""Whole panel: a heading with measures of the shown grasp, and tabs."""

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
    ("Edit", EditPanel),
    ("Validate", ValidatePanel),
    ("Browse", BrowsePanel),
    ("Files", ExportPanel),
    ("View", DisplayPanel),
)
"""Titles and panels of the tabs."""


class PagePanel:
    """Heading and tabs; draws the heading, and shows notices."""

    def __init__(self, server: viser.ViserServer, controller: Controller, view: View) -> None:
        """Make all widgets."""
        self._server, self._view = server, view
        self._heading = server.gui.add_html("")
        self._last_notice = 0
        tabs = server.gui.add_tab_group()
        self.panels: list[Any] = []
        """The panels in the tabs; each draws for itself."""
        for title, kind in PANELS:
            with tabs.add_tab(title):
                self.panels.append(kind(server, controller))
        self.draws = (self.draw, *(panel.draw for panel in self.panels))
        self.slow_draws = tuple(draw for panel in self.panels for draw in getattr(panel, "slow_draws", ()))
        """Functions that draw the page, and those to be called less often."""

    def close(self) -> None:
        """Stop what the panels play."""
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
        # A notice from before the first client is shown to that client.
        if notice is not None and notice.number != self._last_notice and clients:
            self._last_notice = notice.number
            for client in clients:
                client.add_notification(
                    "This did not work" if notice.bad else "grasp-refine",
                    notice.text,
                    color="red" if notice.bad else "blue",
                    auto_close_seconds=None if notice.bad else 8.0,
                )


def _heading(state: State, view: View) -> str:
    """Name and measures of the shown grasp as HTML."""
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
    """Colours of distances in one line of HTML."""
    swatch = "display:inline-block;width:0.8em;height:0.8em;border-radius:50%;vertical-align:-0.05em"
    parts = [
        f'<span><span style="{swatch};background:rgb{color}"></span> {text}</span>' for text, color in distance_legend()
    ]
    return (
        '<div style="display:flex;justify-content:space-between;font-size:0.78em;opacity:0.85;margin-top:0.2em">'
        f"{''.join(parts)}</div>"
    )


SCALE = _scale()
"""Legend of the colours of points and lines between links and object."""
