"""Panel that edits the grasp: gizmos, targets, joints, and undo."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import viser

from grasp_refine.core.se3 import exp_so3, log_so3, transform_points
from grasp_refine.hands.hand import Hand
from grasp_refine_apps.viewer.controller import Controller
from grasp_refine_apps.viewer.panels.held import Held
from grasp_refine_apps.viewer.panels.joints import Joints
from grasp_refine_apps.viewer.panels.paced import Paced
from grasp_refine_apps.viewer.panels.rows import in_a_row
from grasp_refine_apps.viewer.panels.timeline import millimetres
from grasp_refine_apps.viewer.shapes import LinkPoses
from grasp_refine_apps.viewer.state import Gizmo, State

UPDATE_PERIOD_S = 0.2
"""Seconds between two updates of numbers and sliders."""


class EditPanel:
    """Widgets that move hand, object and targets."""

    def __init__(self, server: viser.ViserServer, controller: Controller) -> None:
        """Make the widgets inside the tab or folder that is open."""
        self._controller = controller
        gui = server.gui
        self._undo = gui.add_button("Undo", icon=viser.Icon.ARROW_BACK_UP, hint="Undo the last change")
        self._redo = gui.add_button("Redo", icon=viser.Icon.ARROW_FORWARD_UP, hint="Redo the last undone change")
        self._reset = gui.add_button(
            "Reset", icon=viser.Icon.ROTATE, hint="Reset hand, object and targets to the input grasp"
        )
        in_a_row(gui, (self._undo, self._redo, self._reset))

        def on_click(button: viser.GuiButtonHandle, act: Callable[[], None]) -> None:
            button.on_click(lambda event: act())

        for button, act in (
            (self._undo, controller.undo),
            (self._redo, controller.redo),
            (self._reset, controller.reset),
        ):
            on_click(button, act)
        gizmos: tuple[Gizmo, ...] = ("hand", "object")
        with gui.add_folder("Move with the mouse"):
            self._gizmos = {
                what: Held(
                    gui.add_checkbox(f"{what.capitalize()}", False, hint=f"Arrows and rings that move the {what}"),
                    partial(self._show_gizmo, what),
                )
                for what in gizmos
            }
        with gui.add_folder("Targets"):
            self._picking = Held(
                gui.add_checkbox("Set by clicks", False, hint="Click a link of the hand, then the object"),
                controller.set_picking,
            )
            self._targets = gui.add_markdown("")
            self._delete = gui.add_button_group("Delete", ("-",), visible=False, hint="Delete one target")
            self._delete.on_click(lambda event: self._deleted(event.target.value))
            self._auto = gui.add_button("Auto", icon=viser.Icon.WAND, hint="No targets: links touch where they can")
            self._auto.on_click(lambda event: controller.clear_targets())
            self._nearest = gui.add_button(
                "Nearest points", icon=viser.Icon.TARGET, hint="Where links are nearest now, to be dragged from there"
            )
            in_a_row(gui, (self._auto, self._nearest))
            self._nearest.on_click(lambda event: controller.target_nearest_points())
        with gui.add_folder("Hand pose", expand_by_default=False):
            self._position = Held(
                gui.add_vector3("Position, mm", (0.0, 0.0, 0.0), step=0.1, hint="Of the base link, object frame"),
                self._move,
            )
            self._rotation = Held(
                gui.add_vector3("Rotation, °", (0.0, 0.0, 0.0), step=0.1, hint="Axis times angle, object frame"),
                self._turn,
            )
        self._joints = Joints(gui, controller)
        self._numbers = Paced(UPDATE_PERIOD_S, self._draw_numbers)
        self._poses: tuple[Hand, LinkPoses] | None = None

    def draw(self, state: State) -> None:
        """Show a state."""
        self._undo.disabled, self._redo.disabled = not state.can_undo, not state.can_redo
        for what, held in self._gizmos.items():
            held.show(state.gizmo == what)
        self._picking.show(state.picking)
        self._auto.disabled = not state.targets
        self._numbers(state)

    def close(self) -> None:
        """Stop drawing."""
        self._numbers.close()
        self._joints.close()
        for held in (*self._gizmos.values(), self._picking, self._position, self._rotation):
            held.close()

    def _draw_numbers(self, state: State) -> None:
        """Update the numbers that follow every iteration of a refinement, at a limited rate."""
        shown, hand = state.shown, state.collection.hand
        if self._poses is None or self._poses[0] is not hand:
            self._poses = hand, LinkPoses.of(hand)
        T = shown.T_object_root
        self._targets.content = target_words(state, self._poses[1])
        links = tuple(target.link for target in state.targets)
        if links and links != self._delete.options:
            self._delete.options = links
        self._delete.visible = bool(links)
        self._position.show(tuple(float(x) for x in np.round(1e3 * T[:3, 3], 1) + 0.0))
        turned: np.ndarray = np.degrees(log_so3(T[:3, :3]))
        self._rotation.show(tuple(float(x) for x in np.round(turned, 1) + 0.0))
        self._joints.draw(hand, shown.q)

    def _show_gizmo(self, what: Gizmo, shown: bool) -> None:
        """Show or hide the arrows and rings that move the hand or the object."""
        self._controller.set_gizmo(what if shown else "none")

    def _deleted(self, link: str) -> None:
        links = [target.link for target in self._controller.state.targets]
        if link in links:
            self._controller.delete_target(links.index(link))

    def _move(self, position: tuple[float, float, float]) -> None:
        T = self._controller.state.standing.T_object_root.copy()
        T[:3, 3] = 1e-3 * np.array(position)
        self._controller.move_root(T)

    def _turn(self, rotation: tuple[float, float, float]) -> None:
        T = self._controller.state.standing.T_object_root.copy()
        T[:3, :3] = exp_so3(np.radians(np.array(rotation)))
        self._controller.move_root(T)


def target_words(state: State, poses: LinkPoses) -> str:
    """Text in Markdown on the effect of the next click, and on the targets with their misses."""
    lines = []
    if state.picked is not None:
        lines.append(f"**{state.picked[0]}** is chosen: now click the object where it should touch.")
    elif state.picking:
        lines.append("Click a link of the hand at the point that should touch.")
    if not state.targets:
        lines.append("None: links that are within reach touch where they can.")
        return "\n\n".join(lines)
    T = poses(state.shown.T_object_root, state.shown.q)
    rows = []
    for target in state.targets:
        miss = np.linalg.norm(transform_points(T[target.link], target.point_link) - target.point_object)
        x, y, z = (f"{1e3 * value:.0f}" for value in target.point_object)
        rows.append(f"| {target.link} | {millimetres(float(miss))} | {x}, {y}, {z} |")
    lines.append("\n".join(("| link | miss, mm | on object, mm |", "|:---|---:|---:|", *rows)))
    return "\n\n".join(lines)
