"""Panel that tests the grasp in MuJoCo, reports each direction, and replays it."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import viser

from grasp_refine.validation.protocol import SETTINGS
from grasp_refine_apps.viewer.controller import Controller
from grasp_refine_apps.viewer.panels.play_bar import PlayBar
from grasp_refine_apps.viewer.panels.widgets import on_change, on_click
from grasp_refine_apps.viewer.shown_motion import FRAME_RATE_HZ, ShownMotion
from grasp_refine_apps.viewer.state import Job, State
from grasp_refine_apps.viewer.validated import TrialResult
from grasp_refine_apps.viewer.validated_html import motion_html, notes_html, trial_html
from grasp_refine_apps.viewer.validating import MAX_FRICTION

SETTING_HINTS = {
    "force-closure": "The hand closes and squeezes; then the object, without gravity, is pushed in six directions.",
    "strict": "As force-closure, with half of the friction.",
    "tabletop": "The object lies on a table; the hand closes, squeezes, and lifts it by 10 cm.",
}
"""Meaning of the settings."""

NOT_TESTED = motion_html("Not tested yet.", lost=False)
"""Result of a grasp that was not simulated."""


class ValidatePanel:
    """Widgets for one trial and for its replay; all browsers show the same."""

    def __init__(self, server: viser.ViserServer, controller: Controller) -> None:
        """Make the widgets inside the tab or folder that is open."""
        self._server, self._controller = server, controller
        self._lock = threading.RLock()
        self._trial: TrialResult | None = None
        self._motion: ShownMotion | None = None

        gui = server.gui
        hint = " ".join(f"{name}: {about}" for name, about in SETTING_HINTS.items())
        self.setting = gui.add_dropdown("Setting", tuple(SETTINGS), hint=hint)
        self.friction: Any = gui.add_number(
            "Friction",
            SETTINGS[self.setting.value].friction,
            min=0.01,
            max=MAX_FRICTION,
            step=0.01,
            hint="Coefficient of sliding friction of all contacts; the setting chosen above has its own",
        )
        self.test = gui.add_button("Test in MuJoCo", hint="Simulate whether the grasp that is shown holds the object")
        self.bar: Any = gui.add_progress_bar(0.0, visible=False)
        self.doing = gui.add_html("", visible=False)
        self.stop = gui.add_button("Stop", visible=False, hint="End the simulation")
        self.result = gui.add_html(NOT_TESTED)
        self.watch = gui.add_button_group(
            "Watch", ("+x",), visible=False, hint="Play the simulation of a push along this axis of the object"
        )
        self.line = gui.add_html("", visible=False)
        self.slider = gui.add_slider("Seconds", 0.0, 1.0, 1.0 / FRAME_RATE_HZ, 0.0, hint="Time in the replay")
        self.replay = PlayBar(gui, self.slider, self._shown, controller.show_motion_frame)
        self.replay.set_visible(False)
        self.end = gui.add_button("Close replay", visible=False, hint="Back to the grasp")
        self.notes = gui.add_html("")
        on_change(self.setting, self._choose)
        on_click(self.test, lambda: controller.run_trial(self.setting.value, self._other_friction()))
        on_click(self.stop, controller.stop)
        self.watch.on_click(lambda event: controller.record(event.target.value))
        on_click(self.end, self._end)

    def close(self) -> None:
        """Stop playing."""
        self.replay.close()

    def draw(self, state: State) -> None:
        """Show a state."""
        with self._lock:
            self._draw_job(state.job)
            self._draw_trial(state.trial)
            self._draw_motion(state.motion, state.motion_frame)

    def _choose(self, setting: str) -> None:
        """Choose another setting, with its friction."""
        self.friction.value = SETTINGS[setting].friction

    def _other_friction(self) -> float | None:
        """The coefficient of friction; None where it is that of the setting."""
        own, friction = SETTINGS[self.setting.value].friction, float(self.friction.value)
        return None if abs(friction - own) < 1e-9 else friction

    def _shown(self) -> tuple[ShownMotion | None, int]:
        """The simulation, and the number of its shown frame."""
        state = self._controller.state
        return state.motion, state.motion_frame

    def _end(self) -> None:
        """Return to the grasp."""
        self.replay.pause()
        self._controller.end_motion()

    def _draw_job(self, job: Job | None) -> None:
        """Show the progress of a simulation."""
        ours = job is not None and job.kind in ("validate", "replay")
        self.test.disabled = job is not None and job.kind != "measure"
        self.bar.visible = self.doing.visible = self.stop.visible = ours
        if ours and job is not None:
            self.bar.value = round(100.0 * (job.share or 0.0))
            self.doing.content = motion_html(f"{job.what} …", lost=False)

    def _draw_trial(self, trial: TrialResult | None) -> None:
        """Show the verdict, and the directions that can be watched."""
        if trial is self._trial:
            return
        self._trial = trial
        self.result.content = NOT_TESTED if trial is None else trial_html(trial)
        self.notes.content = "" if trial is None else notes_html(trial)
        if trial is not None:
            self.watch.options = trial.directions
        self.watch.visible = trial is not None and trial.watchable

    def _draw_motion(self, motion: ShownMotion | None, frame: int) -> None:
        """Show the text of a frame; a new motion is played at once, if a browser is connected."""
        new = motion is not self._motion
        if new:
            self._motion = motion
            self.replay.pause()
            self.line.visible = self.end.visible = motion is not None
            self.replay.set_visible(motion is not None)
        if motion is None:
            return
        self.line.content = motion_html(motion.text(frame), lost=bool(motion.lost[frame]))
        times = motion.time - motion.time[0]
        self.replay.draw(np.round(times, 2), times, frame)
        if new and self._server.get_clients():
            self.replay.play()
