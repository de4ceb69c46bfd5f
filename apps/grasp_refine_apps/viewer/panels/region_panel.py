"""Folder with the regions of the object: their specifications, and the brush of the mouse."""

from __future__ import annotations

from typing import Any, cast, get_args

import viser

from grasp_refine.objects.region import ContactRegions
from grasp_refine.objects.region_spec import FORMS
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.painting import SEPARATOR, Brush, specs_text
from grasp_refine_apps.viewer.model.state import State
from grasp_refine_apps.viewer.panels.widgets import in_a_row, on_change

HINT = f"Several with {SEPARATOR} between them: {FORMS}; in the object's frame and metres"
"""Hint of the lines of specifications."""

BRUSH_HINT = (
    "Hold Shift and drag a rectangle over the object: what you see of it there is to be touched, to be avoided, or "
    "erased from both"
)
"""Hint of the brush."""


class RegionPanel:
    """Widgets of the regions."""

    def __init__(self, gui: viser.GuiApi, controller: Controller) -> None:
        """Make the widgets, in a folder."""
        regions = controller.state.scene.regions
        with gui.add_folder("Regions", expand_by_default=regions is not None):
            self.touch: Any = gui.add_text("Touch", "", hint=f"Regions where links should touch. {HINT}")
            self.avoid: Any = gui.add_text("Avoid", "", hint=f"Regions where no link should touch. {HINT}")
            self.apply = gui.add_button("Apply", icon=viser.Icon.CHECK, hint="Heed these regions from now on")
            self.clear = gui.add_button("Clear", icon=viser.Icon.ERASER, hint="No regions: links touch anywhere")
            in_a_row(gui, (self.apply, self.clear))
            self.brush: Any = gui.add_dropdown("Paint", get_args(Brush), hint=BRUSH_HINT)
            self.advice = gui.add_markdown(f"{BRUSH_HINT}.", visible=False)
        self._drawn = ContactRegions()
        # Not in turn with other changes: many faces take a moment.
        self.apply.on_click(lambda event: controller.regions.set(self.touch.value, self.avoid.value))
        self.clear.on_click(lambda event: controller.regions.clear())
        on_change(self.brush, lambda brush: controller.set(brush=cast(Brush, brush)))

    def draw(self, state: State) -> None:
        """Show a state; what a user is writing stays until there are other regions."""
        regions = state.scene.regions or ContactRegions()
        if (regions.touch, regions.avoid) != (self._drawn.touch, self._drawn.avoid):
            self._drawn = regions
            self.touch.value, self.avoid.value = specs_text(regions.touch), specs_text(regions.avoid)
        self.clear.disabled = not (regions.touch or regions.avoid)
        self.advice.visible = state.brush != "off"
        if self.brush.value != state.brush:
            self.brush.value = state.brush
