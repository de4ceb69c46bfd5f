"""The panel that tests the grasp in MuJoCo, says direction by direction what happened, and plays it."""

from __future__ import annotations

import threading
from typing import Any

import viser

from grasp_refine.validation.protocol import SETTINGS
from grasp_refine_apps.viewer.controller import Controller
from grasp_refine_apps.viewer.motion_player import MotionPlayer
from grasp_refine_apps.viewer.panels.held import Held
from grasp_refine_apps.viewer.shown_motion import RATE, ShownMotion
from grasp_refine_apps.viewer.state import Job, State
from grasp_refine_apps.viewer.validated import TrialResult
from grasp_refine_apps.viewer.validated_html import motion_html, notes_html, trial_html
from grasp_refine_apps.viewer.validating import MOST_FRICTION

PLAY, PAUSE = "Play", "Pause"

ABOUT = {
    "force-closure": "The hand closes and squeezes; then the object, without gravity, is pushed in six directions.",
    "strict": "As force-closure, with half of the friction.",
    "tabletop": "The object lies on a table; the hand closes, squeezes, and lifts it by 10 cm.",
}
"""What the settings mean."""


class ValidatePanel:
    """Widgets for one proof and for the motion that is watched; all browsers see the same."""

    def __init__(self, server: viser.ViserServer, controller: Controller) -> None:
        """Make the widgets inside the tab or folder that is open."""
        self._server, self._controller = server, controller
        self._lock = threading.RLock()
        self._player = MotionPlayer(controller.show_motion_frame, self._ended)
        self._proof: TrialResult | None = None
        self._motion: ShownMotion | None = None
        self._frame = 0

        gui = server.gui
        first = next(iter(SETTINGS))
        self._setting = gui.add_dropdown("Setting", tuple(SETTINGS), initial_value=first, hint=_about())
        self._friction: Any = gui.add_number(
            "Friction",
            SETTINGS[first].friction,
            min=0.01,
            max=MOST_FRICTION,
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
        self._slider = gui.add_slider("Seconds", 0.0, 1.0, 1.0 / RATE, 0.0, visible=False, hint="Time in the replay")
        self._seconds = Held(self._slider, self._scrub)
        self._play = gui.add_button(PLAY, visible=False, hint="Play the replay in real time, or hold it")
        self._close = gui.add_button("Close replay", visible=False, hint="Back to the grasp")
        self._notes = gui.add_html("")
        self._connect()

    def close(self) -> None:
        """End what is played."""
        self._player.pause()
        self._seconds.close()

    def draw(self, state: State) -> None:
        """Show a state."""
        with self._lock:
            self._draw_job(state.job)
            self._draw_proof(state.trial)
            self._draw_motion(state.motion, state.motion_frame)

    def _connect(self) -> None:
        """Let the widgets call commands; values that we set ourselves come without a client."""
        self._setting.on_update(self._choose)
        self._test.on_click(lambda event: self._controller.run_trial(self._setting.value, self._other_friction()))
        self._stop.on_click(lambda event: self._controller.stop())
        self._watch.on_click(lambda event: self._controller.watch(event.target.value))
        self._play.on_click(lambda event: self._toggle())
        self._close.on_click(lambda event: self._end())

    # what the user does

    def _choose(self, event: viser.GuiEvent[Any]) -> None:
        """Another setting, with its friction."""
        if event.client is not None:
            self._friction.value = SETTINGS[self._setting.value].friction

    def _other_friction(self) -> float | None:
        """The coefficient of friction; None where it is that of the setting."""
        own = SETTINGS[self._setting.value].friction
        return None if abs(self._friction.value - own) < 1e-9 else float(self._friction.value)

    def _scrub(self, seconds: float) -> None:
        """Look at another moment."""
        motion = self._motion
        if motion is not None:
            self._hold()
            self._controller.show_motion_frame(motion.frame_at(float(seconds)))

    def _toggle(self) -> None:
        """Play, or hold."""
        with self._lock:
            if self._player.playing:
                self._hold()
            elif self._motion is not None:
                self._player.play(self._motion, self._frame)
                _put(self._play, label=PAUSE)

    def _hold(self) -> None:
        """Stay at this frame."""
        self._player.pause()
        _put(self._play, label=PLAY)

    def _ended(self) -> None:
        """The last frame was played."""
        with self._lock:
            if not self._player.playing:
                _put(self._play, label=PLAY)

    def _end(self) -> None:
        """Back to the grasp."""
        self._hold()
        self._controller.end_motion()

    # what is shown

    def _draw_job(self, job: Job | None) -> None:
        """How far a simulation is."""
        ours = job is not None and job.kind in ("prove", "replay")
        _put(self._test, disabled=job is not None and job.kind != "measure")
        for widget in (self._bar, self._doing, self._stop):
            _put(widget, visible=ours)
        if ours and job is not None:
            _put(self._bar, value=round(100.0 * (job.share or 0.0)))
            _put(self._doing, content=motion_html(f"{job.what} …", lost=False))

    def _draw_proof(self, trial: TrialResult | None) -> None:
        """The verdict, and what can be watched."""
        if trial is self._proof:
            return
        self._proof = trial
        _put(self._result, content=motion_html("Not tested yet.", lost=False) if trial is None else trial_html(trial))
        _put(self._notes, content="" if trial is None else notes_html(trial))
        if trial is not None:
            _put(self._watch, options=trial.directions)
        _put(self._watch, visible=trial is not None and trial.watchable)

    def _draw_motion(self, motion: ShownMotion | None, frame: int) -> None:
        """The frame that is seen, in words; a new motion is played at once, if anybody sees it."""
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
    """Set what is not so yet: everything that is set goes to all browsers."""
    for name, value in properties.items():
        if getattr(widget, name) != value:
            setattr(widget, name, value)


def _about() -> str:
    """What all settings mean, for the hint."""
    return " ".join(f"{name}: {about}" for name, about in ABOUT.items())
