"""Slider over the frames of a refinement or a simulation, which also plays them."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Event, Lock, Thread
from typing import Any

import numpy as np
import viser

from grasp_refine.core.array_types import Shaped
from grasp_refine_apps.viewer.model.recording import Recording
from grasp_refine_apps.viewer.panels.widgets import LiveInput, on_click

FRAME_RATE_HZ = 25.0
"""Maximum frame rate in hertz."""

PLAY, PAUSE = "Play", "Pause"


class PlayBar:
    """Slider and play button; playing ends at the last frame, or when anything else moves the state."""

    def __init__(
        self,
        gui: viser.GuiApi,
        slider: Any,
        shown: Callable[[], tuple[Recording | None, int]],
        show: Callable[[int], None],
    ) -> None:
        """Make the button in the container that is open.

        Args:
            gui: The page.
            slider: The slider.
            shown: Returns the recording, and the number of its shown frame.
            show: Called with the number of the frame to show; must return at once.
        """
        self._shown, self._show = shown, show
        self._slider = LiveInput(slider, self._scrub)
        self.button = gui.add_button(PLAY, icon=viser.Icon.MOVIE, hint="Play from here to the end, or pause")
        on_click(self.button, self.toggle)
        self._lock = Lock()
        self._stop: Event | None = None
        self._marks: np.ndarray = np.zeros(1)

    def draw(self, marks: Shaped[np.ndarray, " T"], frame: int) -> None:
        """Show T frames.

        Args:
            marks: Values of the slider, from 0.
            frame: The frame that is shown.
        """
        self._marks = marks
        handle = self._slider.handle
        last = marks[-1].item()
        handle.max = max(last, handle.step)
        self._slider.show(min(marks[frame].item(), handle.max))

    def enable(self, enabled: bool) -> None:
        """Allow or refuse changes by users."""
        self._slider.handle.disabled = self.button.disabled = not enabled

    def set_visible(self, visible: bool) -> None:
        """Show or hide the widgets."""
        self._slider.handle.visible = self.button.visible = visible

    def play(self) -> None:
        """Play from the shown frame on; from the first one, if that is the last."""
        with self._lock:
            if self._stop is not None:
                return
            self._stop = Event()
            self.button.label = PAUSE
            Thread(target=self._run, args=(self._stop,), name="viewer player", daemon=True).start()

    def pause(self) -> None:
        """Stop at the present frame; no further one is shown."""
        with self._lock:
            self._end()

    def close(self) -> None:
        """Stop playing and showing."""
        self.pause()
        self._slider.close()

    def _end(self) -> None:
        if self._stop is not None:
            self._stop.set()
            self._stop = None
            self.button.label = PLAY

    def toggle(self) -> None:
        """Play, or pause; nothing where there is nothing to play."""
        if self.button.disabled or not self.button.visible:
            return
        if self._stop is None:
            self.play()
        else:
            self.pause()

    def _scrub(self, mark: float) -> None:
        """Show the last frame whose mark is at most this."""
        self.pause()
        self._show(_last_at(self._marks, mark))

    def _run(self, stop: Event) -> None:
        """Show one frame after the other, at real speed."""
        source, frame = self._shown()
        # Not the last drawn ones, which may be older.
        times = np.zeros(1) if source is None else source.time - source.time[0]
        frame = frame if frame < len(times) - 1 else 0
        began = time.monotonic() - times[frame]
        while True:
            with self._lock:
                if stop.is_set():
                    return
                self._show(frame)
                if frame == len(times) - 1:
                    break
            stop.wait(1.0 / FRAME_RATE_HZ)
            now, at = self._shown()
            if now is not source or at != frame:
                break
            frame = _last_at(times, time.monotonic() - began)
        with self._lock:
            if not stop.is_set():
                self._end()


def _last_at(values: Shaped[np.ndarray, " T"], value: float) -> int:
    """Index of the last of some ascending values that is at most another one; 0 if there is none."""
    return max(int(np.searchsorted(values, value + 1e-9, side="right")) - 1, 0)
