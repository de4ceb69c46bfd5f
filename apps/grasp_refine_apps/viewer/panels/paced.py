"""Drawing at a limited rate."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock, Timer
from time import monotonic
from typing import Any


class Paced:
    """Rate limit of a drawing function, at most one call in a period: the newest arguments are never left out."""

    def __init__(self, period: float, draw: Callable[..., None]) -> None:
        """Limit `draw`, which is called with the arguments of this, never twice at once; `period` is in seconds."""
        self._period, self._draw = period, draw
        self._lock = Lock()
        self._wanted: tuple[Any, ...] = ()
        self._last = float("-inf")
        self._timer: Timer | None = None
        self._closed = False

    def __call__(self, *wanted: Any) -> None:
        """Draw these arguments, unless newer ones come first."""
        with self._lock:
            self._wanted = wanted
            if self._timer is not None or self._closed:
                return
            wait = self._last + self._period - monotonic()
            if wait <= 0:
                self._now()
                return
            self._timer = Timer(wait, self._late)
            self._timer.daemon = True
            self._timer.start()

    def close(self) -> None:
        """Stop drawing."""
        with self._lock:
            self._closed = True
            if self._timer is not None:
                self._timer.cancel()

    def _late(self) -> None:
        with self._lock:
            self._timer = None
            if not self._closed:
                self._now()

    def _now(self) -> None:
        self._last = monotonic()
        self._draw(*self._wanted)
