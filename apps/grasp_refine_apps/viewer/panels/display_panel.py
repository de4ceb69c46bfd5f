"""Tab with the display options of the scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import viser

from grasp_refine_apps.viewer.drawing.camera import VIEWS
from grasp_refine_apps.viewer.drawing.grasp_nodes import (
    COMPARED_COLOR,
    DEEP_COLOR,
    FORCE_COLOR,
    GHOST_COLOR,
    TARGET_COLOR,
)
from grasp_refine_apps.viewer.drawing.region_nodes import AVOID_COLOR, TOUCH_COLOR
from grasp_refine_apps.viewer.drawing.scan_nodes import MAYBE_COLOR, SEEN_COLOR
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.state import DisplayOptions, State
from grasp_refine_apps.viewer.panels.form import Form
from grasp_refine_apps.viewer.panels.habits import keys_html
from grasp_refine_apps.viewer.server.viser_private import Site


class DisplayPanel:
    """Display options, and the legend."""

    def __init__(self, server: Site, controller: Controller) -> None:
        """Make the widgets."""
        state, gui = controller.state, server.gui
        self.look: Callable[[viser.ClientHandle, str], None] = lambda client, view: None
        """Places the camera of a page; set by whoever draws, as `cut` is."""
        self.cut: Callable[[viser.ClientHandle, float], None] = lambda client, share: None
        views = gui.add_button_group("Look at", tuple(view.capitalize() for view in VIEWS), hint="Keys 1 to 4")
        cut = gui.add_slider("Cut away", 0, 100, 1, 0, hint="What is nearest to the camera, in % of the depth")
        views.on_click(self._look_at)
        cut.on_update(self._cut_away)
        names = tuple(field.name for field in fields(DisplayOptions))
        # Scenes keep what is around the object, or have nothing there, as long as the viewer runs.
        alone = state.scene.table is None and state.scene.environment is None
        absent = {"surroundings": alone, "scan": state.scene.object.scan is None}
        left_out = tuple(name for name, missing in absent.items() if missing)
        shown = [name for name in names if name not in left_out]
        self.form = Form(
            server.gui,
            state.display,
            lambda display: controller.set(display=display),
            controller.notify,
            first=shown,
            left_out=left_out,
        )
        server.gui.add_html(_legend())
        server.gui.add_html(keys_html())

    def _look_at(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            self.look(event.client, event.target.value.lower())

    def _cut_away(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            self.cut(event.client, event.target.value / 100)

    def draw(self, state: State) -> None:
        """Show a state."""
        self.form.show(state.display)


def _legend() -> str:
    rows = [
        ((242, 184, 102), "links that are meant to touch"),
        ((220, 90, 80), "links inside the object or touching elsewhere, and obstacles"),
        (GHOST_COLOR, "the input hand"),
        (COMPARED_COLOR, "the hand in the grasp that is compared"),
        (TARGET_COLOR, "target: where a link should touch"),
        (FORCE_COLOR, "contact forces, in their friction cones"),
        (DEEP_COLOR, "the push in a simulation"),
        (TOUCH_COLOR, "on the object: where links may touch it"),
        (AVOID_COLOR, "on the object: where they may not"),
        (SEEN_COLOR, "of a scan: points that were seen"),
        (MAYBE_COLOR, "of a scan: edges of the other solids that the object may be"),
    ]
    swatch = "display:inline-block;width:0.9em;height:0.9em;border-radius:50%;margin-right:0.5em;vertical-align:middle"
    lines = "".join(f'<div><span style="{swatch};background:rgb{color}"></span>{text}</div>' for color, text in rows)
    return f'<div style="padding:0.2em 1em 0.6em;font-size:0.85em;line-height:1.6">{lines}</div>'
