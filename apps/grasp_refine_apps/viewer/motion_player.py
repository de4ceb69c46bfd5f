"""Real-time player of motions: calls back with one frame after the other, from its own thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from grasp_refine_apps.viewer.shown_motion import ShownMotion

FRAME_RATE_HZ = 25.0
"""Maximum frame rate in hertz."""


class MotionPlayer:
    """Player of one motion at a time, at real speed, up to its last frame."""

    def __init__(self, show: Callable[[int], None], ended: Callable[[], None]) -> None:
        """Start without a motion.

        Args:
            show: Called with the number of each frame by the player's thread; must return at once.
            ended: Called by that thread after the last frame.
        """
        self._show, self._ended = show, ended
        self._lock = threading.Lock()
        self._stop: threading.Event | None = None

    @property
    def playing(self) -> bool:
        """Whether a motion is playing."""
        return self._stop is not None

    def play(self, motion: ShownMotion, frame: int = 0) -> None:
        """Play a motion from a frame on, instead of a playing one; from the first frame, if that is the last."""
        first = frame if frame < len(motion) - 1 else 0
        stop = threading.Event()
        with self._lock:
            self._pause()
            self._stop = stop
        threading.Thread(target=self._run, args=(motion, first, stop), name="viewer motion", daemon=True).start()

    def pause(self) -> None:
        """Stop at the present frame; no further one is shown."""
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
            stop.wait(1.0 / FRAME_RATE_HZ)
            frame = motion.frame_at(time.monotonic() - began)
        self._ended()
