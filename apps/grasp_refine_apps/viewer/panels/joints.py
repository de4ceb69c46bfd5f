"""Sliders of the joints of a hand, by finger."""

from __future__ import annotations

from functools import partial

import numpy as np
import viser

from grasp_refine.core.array_types import Float
from grasp_refine.hands.hand import Hand
from grasp_refine.scene.contact_selection import link_groups
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.panels.widgets import LiveInput

SLIDER_STEP = 0.1
"""Step of the sliders, in degrees or mm."""


class Joints:
    """Sliders of the independent joints; built anew for another hand."""

    def __init__(self, gui: viser.GuiApi, controller: Controller) -> None:
        """Make the folder in the container that is open."""
        self._gui, self._controller = gui, controller
        self._folder = gui.add_folder("Joints, degrees or mm")
        self._hand: Hand | None = None
        self._parts: list[viser.GuiFolderHandle] = []
        self.sliders: list[LiveInput] = []

    def draw(self, hand: Hand, q: Float[np.ndarray, " n"]) -> None:
        """Show the joint values of a hand, radians or metres."""
        if hand is not self._hand:
            self.close()
            for part in self._parts:
                part.remove()
            self._hand, self._parts, self.sliders = hand, [], []
            with self._folder:
                self._build(hand)
        for i, (slider, value, scale) in enumerate(zip(self.sliders, q, units(hand), strict=True)):
            handle = slider.handle
            shown = value * scale
            if not np.isfinite(hand.upper[i]) and hand.joints_by_name[hand.joint_names[i]].kind != "prismatic":
                shown = (shown + 180.0) % 360.0 - 180.0
            slider.show(float(np.clip(round(shown, 1), handle.min, handle.max)))

    def close(self) -> None:
        """Stop showing values."""
        for slider in self.sliders:
            slider.close()

    def _build(self, hand: Hand) -> None:
        fingers = link_groups(hand, tuple(hand.joints_by_name[name].child for name in hand.joint_names))
        sliders: dict[int, LiveInput] = {}
        scales = units(hand)
        for finger in dict.fromkeys(fingers):
            title = finger.capitalize() if finger.isalpha() else finger
            self._parts.append(self._gui.add_folder(title, expand_by_default=not self._parts))
            with self._parts[-1]:
                for i, name in enumerate(hand.joint_names):
                    if fingers[i] == finger:
                        sliders[i] = self._slider(hand, i, name, scales[i])
        self.sliders = [sliders[i] for i in range(len(sliders))]

    def _slider(self, hand: Hand, i: int, name: str, scale: float) -> LiveInput:
        kind = hand.joints_by_name[name].kind
        lower, upper = (float(round(limit, 1)) for limit in limits(hand, i, scale))
        handle = self._gui.add_slider(
            name,
            lower,
            max(upper, lower + SLIDER_STEP),
            SLIDER_STEP,
            lower,
            disabled=bool(hand.lower[i] == hand.upper[i]),
            hint=f"{'mm' if kind == 'prismatic' else 'degrees'}, from {lower:g} to {upper:g}",
        )
        return LiveInput(handle, partial(self._set, i, scale))

    def _set(self, i: int, scale: float, value: float) -> None:
        self._controller.editor.set_joint(i, value / scale)


def units(hand: Hand) -> Float[np.ndarray, " n"]:
    """Factors (n,) from joint values to displayed units: degrees, or mm for prismatic joints."""
    kinds = [hand.joints_by_name[name].kind for name in hand.joint_names]
    return np.array([1e3 if kind == "prismatic" else np.degrees(1.0) for kind in kinds])


def limits(hand: Hand, i: int, scale: float) -> tuple[float, float]:
    """Limits of a joint, in degrees or mm; of a continuous joint, a full turn."""
    lower, upper = scale * hand.lower[i], scale * hand.upper[i]
    return (lower if np.isfinite(lower) else -180.0), (upper if np.isfinite(upper) else 180.0)
