"""Panel that edits the grasp: gizmos, targets, regions, joints, and undo."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
import viser

from grasp_refine.core.se3 import exp_so3, log_so3
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.contacts import Contacts
from grasp_refine_apps.viewer.model.state import Gizmo, State
from grasp_refine_apps.viewer.panels.joints import Joints
from grasp_refine_apps.viewer.panels.region_panel import RegionPanel
from grasp_refine_apps.viewer.panels.widgets import LiveInput, in_a_row, on_choice, on_click
from grasp_refine_apps.viewer.server.viser_private import Site

GIZMOS: Mapping[Gizmo, str] = {
    "hand": "Arrows and rings that move the hand",
    "object": "Arrows and rings that move the object",
    "fingers": "Drag a link: its finger follows within its limits, and stops at the object",
}
"""Bodies that the mouse moves, and how."""


class EditPanel:
    """Widgets that move hand, object and targets."""

    def __init__(self, server: Site, controller: Controller) -> None:
        """Make the widgets inside the tab or folder that is open."""
        self._controller = controller
        gui = server.gui
        self.undo = gui.add_button("Undo", icon=viser.Icon.ARROW_BACK_UP, hint="Undo the last change")
        self.redo = gui.add_button("Redo", icon=viser.Icon.ARROW_FORWARD_UP, hint="Redo the last undone change")
        self.reset = gui.add_button(
            "Reset", icon=viser.Icon.ROTATE, hint="Reset hand, object and targets to the input grasp"
        )
        in_a_row(gui, (self.undo, self.redo, self.reset))
        with gui.add_folder("Move with the mouse"):
            self.gizmos = {
                body: LiveInput(
                    gui.add_checkbox(f"{body.capitalize()}", False, hint=hint), partial(self._show_gizmo, body)
                )
                for body, hint in GIZMOS.items()
            }
        with gui.add_folder("Targets"):
            self.picking = LiveInput(
                gui.add_checkbox("Set by clicks", False, hint="Click a link of the hand, then the object"),
                controller.targets.set_picking,
            )
            self.targets = gui.add_markdown("")
            self.delete = gui.add_button_group("Delete", ("-",), visible=False, hint="Delete one target")
            on_choice(self.delete, self._delete)
            self.auto = gui.add_button("Auto", icon=viser.Icon.WAND, hint="No targets: links touch where they can")
            self.nearest = gui.add_button(
                "Nearest points", icon=viser.Icon.TARGET, hint="Where links are nearest now, to be dragged from there"
            )
            in_a_row(gui, (self.auto, self.nearest))
        self.regions = RegionPanel(gui, controller)
        with gui.add_folder("Hand pose", expand_by_default=False):
            self.position = LiveInput(
                gui.add_vector3("Position, mm", (0.0, 0.0, 0.0), step=0.1, hint="Of the base link, object frame"),
                self._move,
            )
            self.rotation = LiveInput(
                gui.add_vector3("Rotation, °", (0.0, 0.0, 0.0), step=0.1, hint="Axis times angle, object frame"),
                self._turn,
            )
        on_click(self.undo, controller.editor.undo)
        on_click(self.redo, controller.editor.redo)
        on_click(self.reset, controller.editor.reset)
        on_click(self.auto, controller.targets.clear)
        on_click(self.nearest, controller.targets.set_nearest)
        self.joints = Joints(gui, controller)
        self.slow_draws = (self._draw_numbers,)

    def draw(self, state: State) -> None:
        """Show a state."""
        self.undo.disabled, self.redo.disabled = not state.undo_steps, not state.redo_steps
        for body, checkbox in self.gizmos.items():
            checkbox.show(state.gizmo == body)
        self.picking.show(state.picking)
        self.auto.disabled = not state.targets
        self.regions.draw(state)

    def close(self) -> None:
        """Stop moving sliders."""
        self.joints.close()
        for live in (*self.gizmos.values(), self.picking, self.position, self.rotation):
            live.close()

    def _draw_numbers(self, state: State) -> None:
        """Update numbers and sliders, which would follow every iteration of a refinement."""
        shown, hand = state.shown, state.collection.hand
        T = shown.T_object_root
        self.targets.content = targets_text(state, self._controller.contacts(state))
        links = tuple(target.link for target in state.targets)
        if links:
            self.delete.options = links
        self.delete.visible = bool(links)
        turned: np.ndarray = log_so3(T[:3, :3])
        # Adding zero turns -0.0 to 0.0.
        self.position.show(tuple((np.round(1e3 * T[:3, 3], 1) + 0.0).tolist()))
        self.rotation.show(tuple((np.round(np.degrees(turned), 1) + 0.0).tolist()))
        self.joints.draw(hand, shown.q)

    def _show_gizmo(self, body: Gizmo, shown: bool) -> None:
        """Let the mouse move a body, or nothing."""
        self._controller.set(gizmo=body if shown else "none")

    def _delete(self, link: str) -> None:
        """Delete the target of a link."""
        links = [target.link for target in self._controller.state.targets]
        if link in links:
            self._controller.targets.delete(links.index(link))

    def _move(self, position: tuple[float, float, float]) -> None:
        """Move the hand to a position in mm."""
        T = self._controller.state.standing.T_object_root.copy()
        T[:3, 3] = 1e-3 * np.array(position)
        self._controller.editor.move_root(T)

    def _turn(self, rotation: tuple[float, float, float]) -> None:
        """Turn the hand to a rotation vector in degrees."""
        T = self._controller.state.standing.T_object_root.copy()
        T[:3, :3] = exp_so3(np.radians(np.array(rotation)))
        self._controller.editor.move_root(T)


def targets_text(state: State, contacts: Contacts) -> str:
    """Text in Markdown on the effect of the next click, and on the targets with the contact errors of their links."""
    lines = []
    if state.picked is not None:
        lines.append(f"**{state.picked[0]}** is chosen: now click the object where it should touch.")
    elif state.picking:
        lines.append("Click a link of the hand at the point that should touch.")
    if not state.targets:
        lines.append("None: links that are within reach touch where they can.")
        return "\n\n".join(lines)
    error = dict(zip(contacts.link, contacts.error, strict=True))
    rows = []
    for target in state.targets:
        x, y, z = (f"{1e3 * value:.0f}" for value in target.point_object)
        rows.append(f"| {target.link} | {1e3 * error.get(target.link, np.nan):.2f} | {x}, {y}, {z} |")
    lines.append("\n".join(("| link | error, mm | on object, mm |", "|:---|---:|---:|", *rows)))
    return "\n\n".join(lines)
