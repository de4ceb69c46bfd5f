"""Timeline of a refinement: a slider over all iterations, which also plays them, and their measures."""

from __future__ import annotations

from math import ceil
from threading import Event, Lock, Thread

import numpy as np
import viser

from grasp_refine_apps.viewer.controller import Controller
from grasp_refine_apps.viewer.panels.held import Held
from grasp_refine_apps.viewer.state import State

PLAY_RATE_HZ = 20.0
"""Iterations played per second."""
MAX_PLAY_S = 10.0
"""Maximum seconds of playing: where there are more iterations, some are left out."""
PLAY, STOP = "Play", "Stop playing"


class Timeline:
    """Slider, play button and a line of numbers."""

    def __init__(self, gui: viser.GuiApi, controller: Controller) -> None:
        """Make the widgets in the container that is open."""
        self._controller = controller
        handle = gui.add_slider("Iteration", 0, 1, 1, 0, disabled=True, hint="Drag to see the hand in each iteration")
        self._slider = Held(handle, self._scrub)
        self._play = gui.add_button(PLAY, icon=viser.Icon.MOVIE, hint="Play all iterations")
        self._play.on_click(lambda event: self._toggle())
        self._numbers = gui.add_markdown("")
        self._lock = Lock()
        self._stop: Event | None = None

    def draw(self, state: State) -> None:
        """Show a state."""
        handle, trace = self._slider.handle, state.trace
        last = 0 if trace is None else len(trace) - 1
        handle.disabled = self._play.disabled = last == 0
        handle.max = max(last, 1)
        self._slider.show(last if state.frame is None else min(state.frame, last))
        self._numbers.content = numbers(state)

    def close(self) -> None:
        """Stop playing."""
        self._slider.close()
        with self._lock:
            if self._stop is not None:
                self._stop.set()

    def _scrub(self, frame: int) -> None:
        """Show an iteration; at the last one of a refinement that runs, follow it."""
        state = self._controller.state
        last = 0 if state.trace is None else len(state.trace) - 1
        runs = state.job is not None and state.job.kind == "refine"
        self._controller.scrub(None if runs and frame >= last else frame)

    def _toggle(self) -> None:
        """Play from the iteration that is shown, from the first one if that is the last; or stop."""
        with self._lock:
            if self._stop is not None:
                self._stop.set()
                return
            self._stop = Event()
            self._play.label = STOP
            Thread(target=self._run, args=(self._stop,), name="viewer timeline", daemon=True).start()

    def _run(self, stop: Event) -> None:
        """Play until the end, a stop, or another move of the timeline."""
        state = self._controller.state
        trace, frame = state.trace, state.frame
        if trace is not None:
            last, stride = len(trace) - 1, ceil(len(trace) / (PLAY_RATE_HZ * MAX_PLAY_S))
            at = 0 if frame is None or frame >= last else frame
            while not stop.is_set():
                self._controller.scrub(at)
                ended = at >= last or stop.wait(1.0 / PLAY_RATE_HZ)
                state = self._controller.state
                if ended or state.trace is not trace or state.frame != at:
                    break
                at = min(at + stride, last)
        with self._lock:
            self._stop = None
        self._play.label = PLAY


def numbers(state: State) -> str:
    """Text on the measures of the shown iteration."""
    trace = state.trace
    if trace is None:
        return "Each iteration of a refinement can be shown here."
    k = len(trace) - 1 if state.frame is None else min(state.frame, len(trace) - 1)
    if state.frame is None and state.job is None and not state.pose.same(trace.pose(k)):
        return "The hand was moved since: drag the timeline to see the refinement again."
    error, depth = (millimetres(float(values[k])) for values in (trace.contact_error, trace.penetration))
    return f"**{_capital(trace.label[k])}**: contact error {error} mm, penetration {depth} mm"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def millimetres(metres: float) -> str:
    """A length in mm, without the unit; a dash where it is not known."""
    if np.isnan(metres):
        return "–"
    if 0.0 < metres < 1e-6:
        return "< 0.001"
    return f"{1e3 * metres:.{3 if metres < 1e-4 else 2}f}"
