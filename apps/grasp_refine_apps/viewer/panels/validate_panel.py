"""Panel that tests the grasp in MuJoCo, reports each direction, and replays it."""

from __future__ import annotations

import threading
from typing import Any

import viser

from grasp_refine.validation.protocol import SETTINGS
from grasp_refine_apps.viewer.controller import Controller
from grasp_refine_apps.viewer.motion_player import MotionPlayer
from grasp_refine_apps.viewer.panels.held import Held
from grasp_refine_apps.viewer.shown_motion import FRAME_RATE_HZ, ShownMotion
from grasp_refine_apps.viewer.state import Job, State
from grasp_refine_apps.viewer.validated import TrialResult
from grasp_refine_apps.viewer.validated_html import motion_html, notes_html, trial_html
from grasp_refine_apps.viewer.validating import MAX_FRICTION

PLAY, PAUSE = "Play", "Pause"

SETTING_HINTS = {
    "force-closure": "The hand closes and squeezes; then the object, without gravity, is pushed in six directions.",
    "strict": "As force-closure, with half of the friction.",
    "tabletop": "The object lies on a table; the hand closes, squeezes, and lifts it by 10 cm.",
}
"""Meaning of the settings."""


class ValidatePanel:
    """Widgets for one trial and for its replay; all browsers show the same."""

    def __init__(self, server: viser.ViserServer, controller: Controller) -> None:
        """Make the widgets inside the tab or folder that is open."""
        self._server, self._controller = server, controller
        self._lock = threading.RLock()
        self._player = MotionPlayer(controller.show_motion_frame, self._ended)
        self._trial: TrialResult | None = None
        self._motion: ShownMotion | None = None
        self._frame = 0

        gui = server.gui
        first = next(iter(SETTINGS))
        self._setting = gui.add_dropdown("Setting", tuple(SETTINGS), initial_value=first, hint=_settings_hint())
        self._friction: Any = gui.add_number(
            "Friction",
            SETTINGS[first].friction,
            min=0.01,
            max=MAX_FRICTION,
            step=0.01,
            hint="Coefficient of sliding friction of all contacts; the setting chosen above has its own",
        )
        self._test = gui.add_button("Test in MuJoCo", hint="Simulate whether the grasp that is shown holds the object")
        self._bar = gui.add_progress_bar(0.0, visible=False)
        self._doing = gui.add_html("", visible=False)
        self._stop = gui.add_button("Stop", visible=False, hint="End the simulation")
        self._result = gui.add_html(motion_html("Not tested yet.", lost=False))
        self._watch = gui.add_button_group(
            "Watch",
            ("+x",),
            visible=False,
            hint="Play the simulation of a push along this axis of the object",
        )
        self._line = gui.add_html("", visible=False)
        self._slider = gui.add_slider(
            "Seconds", 0.0, 1.0, 1.0 / FRAME_RATE_HZ, 0.0, visible=False, hint="Time in the replay"
        )
        self._seconds = Held(self._slider, self._scrub)
        self._play = gui.add_button(PLAY, visible=False, hint="Play the replay in real time, or pause it")
        self._close = gui.add_button("Close replay", visible=False, hint="Back to the grasp")
        self._notes = gui.add_html("")
        self._connect()

    def close(self) -> None:
        """Stop playing."""
        self._player.pause()
        self._seconds.close()

    def draw(self, state: State) -> None:
        """Show a state."""
        with self._lock:
            self._draw_job(state.job)
            self._draw_trial(state.trial)
            self._draw_motion(state.motion, state.motion_frame)

    def _connect(self) -> None:
        """Connect the widgets to commands; values that the program sets come without a client."""
        self._setting.on_update(self._choose)
        self._test.on_click(lambda event: self._controller.run_trial(self._setting.value, self._other_friction()))
        self._stop.on_click(lambda event: self._controller.stop())
        self._watch.on_click(lambda event: self._controller.watch(event.target.value))
        self._play.on_click(lambda event: self._toggle())
        self._close.on_click(lambda event: self._end())

    # commands

    def _choose(self, event: viser.GuiEvent[Any]) -> None:
        """Choose another setting, with its friction."""
        if event.client is not None:
            self._friction.value = SETTINGS[self._setting.value].friction

    def _other_friction(self) -> float | None:
        """The coefficient of friction; None where it is that of the setting."""
        own = SETTINGS[self._setting.value].friction
        return None if abs(self._friction.value - own) < 1e-9 else float(self._friction.value)

    def _scrub(self, seconds: float) -> None:
        """Show another moment of the replay."""
        motion = self._motion
        if motion is not None:
            self._hold()
            self._controller.show_motion_frame(motion.frame_at(float(seconds)))

    def _toggle(self) -> None:
        """Play, or pause."""
        with self._lock:
            if self._player.playing:
                self._hold()
            elif self._motion is not None:
                self._player.play(self._motion, self._frame)
                _put(self._play, label=PAUSE)

    def _hold(self) -> None:
        """Pause at the present frame."""
        self._player.pause()
        _put(self._play, label=PLAY)

    def _ended(self) -> None:
        """Show the play button after the last frame."""
        with self._lock:
            if not self._player.playing:
                _put(self._play, label=PLAY)

    def _end(self) -> None:
        """Return to the grasp."""
        self._hold()
        self._controller.end_motion()

    # widgets

    def _draw_job(self, job: Job | None) -> None:
        """Show the progress of a simulation."""
        ours = job is not None and job.kind in ("validate", "replay")
        _put(self._test, disabled=job is not None and job.kind != "measure")
        for widget in (self._bar, self._doing, self._stop):
            _put(widget, visible=ours)
        if ours and job is not None:
            _put(self._bar, value=round(100.0 * (job.share or 0.0)))
            _put(self._doing, content=motion_html(f"{job.what} …", lost=False))

    def _draw_trial(self, trial: TrialResult | None) -> None:
        """Show the verdict, and the directions that can be watched."""
        if trial is self._trial:
            return
        self._trial = trial
        _put(self._result, content=motion_html("Not tested yet.", lost=False) if trial is None else trial_html(trial))
        _put(self._notes, content="" if trial is None else notes_html(trial))
        if trial is not None:
            _put(self._watch, options=trial.directions)
        _put(self._watch, visible=trial is not None and trial.watchable)

    def _draw_motion(self, motion: ShownMotion | None, frame: int) -> None:
        """Show the text of a frame; a new motion is played at once, if a browser is connected."""
        if motion is not self._motion:
            self._motion = motion
            self._player.pause()
            for widget in (self._line, self._slider, self._play, self._close):
                _put(widget, visible=motion is not None)
            if motion is not None:
                watched = bool(self._server.get_clients())
                _put(self._slider, max=round(motion.seconds, 2))
                _put(self._play, label=PAUSE if watched else PLAY)
                if watched:
                    self._player.play(motion, frame)
        if motion is None:
            return
        self._frame = min(frame, len(motion) - 1)
        _put(self._line, content=motion_html(motion.text(self._frame), lost=bool(motion.lost[self._frame])))
        seconds = round(float(motion.time[self._frame] - motion.time[0]), 2)
        self._seconds.show(min(seconds, self._slider.max))


def _put(widget: Any, **properties: Any) -> None:
    """Set the properties that differ: each one that is set goes to all browsers."""
    for name, value in properties.items():
        if getattr(widget, name) != value:
            setattr(widget, name, value)


def _settings_hint() -> str:
    """Meaning of all settings, for the hint."""
    return " ".join(f"{name}: {about}" for name, about in SETTING_HINTS.items())
