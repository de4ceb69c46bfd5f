"""Plays the iterations of a refinement like a film."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil
from threading import Event, Lock, Thread

from ..controller import Controller

RATE = 20.0
"""Iterations that are shown in a second."""
LONGEST = 10.0
"""Seconds that the longest film takes: where there are more iterations, some are left out."""


class Player:
    """Moves the timeline; ends by itself, also when somebody else moves it."""

    def __init__(self, controller: Controller, changed: Callable[[bool], None]) -> None:
        """Play nothing yet; `changed` hears whether something is played."""
        self._controller, self._changed = controller, changed
        self._lock = Lock()
        self._stop: Event | None = None

    def toggle(self) -> None:
        """Play from the iteration that is shown, from the first one if that is the last; or stop."""
        with self._lock:
            if self._stop is not None:
                self._stop.set()
                return
            self._stop = Event()
            Thread(target=self._play, args=(self._stop,), name="viewer timeline", daemon=True).start()

    def close(self) -> None:
        """Stop."""
        with self._lock:
            if self._stop is not None:
                self._stop.set()

    def _play(self, stop: Event) -> None:
        self._changed(True)
        state = self._controller.state
        trace, frame = state.trace, state.frame
        if trace is not None:
            last, stride = len(trace) - 1, ceil(len(trace) / (RATE * LONGEST))
            at = 0 if frame is None or frame >= last else frame
            while not stop.is_set():
                self._controller.scrub(at)
                ended = at >= last or stop.wait(1.0 / RATE)
                state = self._controller.state
                if ended or state.trace is not trace or state.frame != at:
                    break
                at = min(at + stride, last)
        with self._lock:
            self._stop = None
        self._changed(False)
