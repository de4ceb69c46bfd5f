"""Plays motions in real time: calls back with one frame after the other, from a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from grasp_refine_apps.viewer.shown_motion import ShownMotion

RATE = 25.0
"""Most frames in a second that are asked for."""


class MotionPlayer:
    """Plays one motion at a time, at the speed at which it happened; ends by itself."""

    def __init__(self, show: Callable[[int], None], ended: Callable[[], None]) -> None:
        """Nothing is played yet.

        Args:
            show: Gets the number of each frame; is called by the player's thread, and must return at once.
            ended: Is called by that thread when the last frame was shown.
        """
        self._show, self._ended = show, ended
        self._lock = threading.Lock()
        self._stop: threading.Event | None = None

    @property
    def playing(self) -> bool:
        """Whether something is played."""
        return self._stop is not None

    def play(self, motion: ShownMotion, frame: int = 0) -> None:
        """Play from that frame on, instead of what is played; from the first one, if that frame is the last."""
        first = frame if frame < len(motion) - 1 else 0
        stop = threading.Event()
        with self._lock:
            self._pause()
            self._stop = stop
        threading.Thread(target=self._run, args=(motion, first, stop), name="viewer motion", daemon=True).start()

    def pause(self) -> None:
        """Stay at the present frame; no further one is shown after this."""
        with self._lock:
            self._pause()

    def _pause(self) -> None:
        if self._stop is not None:
            self._stop.set()
            self._stop = None

    def _run(self, motion: ShownMotion, frame: int, stop: threading.Event) -> None:
        """Show the frames from `frame` on until the last one, or until `stop`."""
        began = time.monotonic() - float(motion.time[frame] - motion.time[0])
        while True:
            with self._lock:
                if stop.is_set():
                    return
                self._show(frame)
                if frame == len(motion) - 1:
                    self._stop = None
                    break
            stop.wait(1.0 / RATE)
            frame = motion.frame_at(time.monotonic() - began)
        self._ended()
