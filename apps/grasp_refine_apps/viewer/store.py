"""Present state, and listeners to new ones."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from grasp_refine_apps.viewer.history import History
from grasp_refine_apps.viewer.state import Notice, State


class Store:
    """Keeps the state; the base of the controller."""

    def __init__(self, state: State) -> None:
        """Start with a state."""
        self._lock = threading.RLock()
        self._listeners: list[Callable[[State], None]] = []
        self._history = History()
        self._notices = 0
        self._state = state

    @property
    def state(self) -> State:
        """The present state."""
        return self._state

    def listen(self, listener: Callable[[State], None]) -> None:
        """Call `listener` with every new state; it must return at once and call no command."""
        with self._lock:
            self._listeners.append(listener)

    def say(self, text: str, bad: bool = False) -> None:
        """Show a message to the user."""
        with self._lock:
            self._notices += 1
            self._set(notice=Notice(self._notices, text, bad))

    def _set(self, **changes: Any) -> None:
        with self._lock:
            self._become(replace(self._state, **changes))

    def _become(self, state: State) -> None:
        """Make a state the present one, and call all listeners."""
        with self._lock:
            history = self._history
            self._state = replace(
                state, can_undo=history.can_undo, can_redo=history.can_redo, change=self._state.change + 1
            )
            for listener in self._listeners:
                listener(self._state)
