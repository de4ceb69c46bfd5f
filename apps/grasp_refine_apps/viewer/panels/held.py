"""Input widget that states set and that a user may be moving at the same time."""

from __future__ import annotations

from asyncio import TimerHandle
from collections.abc import Callable
from threading import Lock
from time import monotonic
from typing import Any

HOLD_S = 0.5
"""Seconds after a user's last movement during which states do not move the widget: they may be older."""


class Held:
    """Slider or other input that shows values and sends a user's changes; late states do not move it back.

    The widget is moved in viser's own thread, where movements of users arrive, too: none is lost between reading and
    setting the widget.
    """

    def __init__(self, handle: Any, send: Callable[[Any], None]) -> None:
        """Listen to a widget.

        Args:
            handle: The widget.
            send: Called with its value when a user moved it; must return at once.
        """
        self.handle, self._send = handle, send
        self._loop = handle._impl.gui_api._event_loop
        self._sending = Lock()
        self._known = self._shown = handle.value
        self._until = float("-inf")
        self._timer: TimerHandle | None = None
        self._closed = False
        handle.on_update(lambda event: self._moved() if event.client is not None else None)

    def show(self, value: Any) -> None:
        """Show a value soon or, if a user is moving the widget, soon after that; the newest counts."""
        self._shown = value
        if self.handle.value != value:
            self._loop.call_soon_threadsafe(self._settle)

    def close(self) -> None:
        """Stop showing values: the widget will be removed."""
        self._closed = True

    def _settle(self) -> None:
        """Move the widget, or wait until no user does; in viser's thread."""
        if self._closed or self.handle._impl.removed:
            return
        if self.handle.value != self._known:
            # A user moved it just now; `_moved` was not called yet.
            self._touched()
        wait = self._until - monotonic()
        if wait <= 0:
            self.handle.value = self._shown
            self._known = self.handle.value
        elif self._timer is None:
            self._timer = self._loop.call_later(wait, self._late)

    def _late(self) -> None:
        self._timer = None
        self._settle()

    def _moved(self) -> None:
        """Send a user's change; viser calls this in any of its threads, and not always in order."""
        with self._sending:
            self._touched()
            # What the widget shows now, not what it showed when it was moved.
            self._send(self._known)

    def _touched(self) -> None:
        self._known, self._until = self.handle.value, monotonic() + HOLD_S
