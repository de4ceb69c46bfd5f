"""A widget that states move and that a user may be moving at the same time."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock, Timer
from time import monotonic
from typing import Any

HOLD = 0.5
"""Seconds after a user's last movement during which states do not move the widget: they may be older."""


class Held:
    """Shows values in a slider or another input and sends what a user makes of it; late states do not push it back."""

    def __init__(self, handle: Any, send: Callable[[Any], None]) -> None:
        """Listen to a widget.

        Args:
            handle: The widget.
            send: Gets its value when a user moved it; must return at once and not wait for what calls `show`.
        """
        self.handle, self._send = handle, send
        self._lock = Lock()
        self._known = self._shown = handle.value
        self._until = float("-inf")
        self._timer: Timer | None = None
        handle.on_update(lambda event: self._moved() if event.client is not None else None)

    def show(self, value: Any) -> None:
        """Show a value: now or, if a user is moving the widget, soon after that; the newest counts."""
        with self._lock:
            self._shown = value
            self._show()

    def close(self) -> None:
        """Show nothing any more: the widget will be removed."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()

    def _show(self) -> None:
        if self.handle.value != self._known:
            # A user moved it and viser has not told us yet.
            self._touched()
        wait = self._until - monotonic()
        if wait > 0:
            if self._timer is None:
                self._timer = Timer(wait, self._late)
                self._timer.daemon = True
                self._timer.start()
            return
        self.handle.value = self._shown
        self._known = self.handle.value

    def _late(self) -> None:
        with self._lock:
            self._timer = None
            if not self.handle._impl.removed:
                self._show()

    def _moved(self) -> None:
        # What the widget shows now, not what it showed when viser made the event: events may overtake each other.
        with self._lock:
            self._touched()
            self._shown = self._known
            self._send(self._known)

    def _touched(self) -> None:
        self._known, self._until = self.handle.value, monotonic() + HOLD
