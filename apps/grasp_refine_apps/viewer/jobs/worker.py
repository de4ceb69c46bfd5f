"""Control of a long job in the worker thread: it can be paused, stepped and stopped."""

from __future__ import annotations

import threading
from collections.abc import Callable


class Stopped(Exception):
    """End of a job that the user stopped."""


class Control:
    """Control and progress of one job, for both threads."""

    def __init__(self, report: Callable[[float | None, str], None]) -> None:
        """Start unpaused; `report` is called with the completed share (0 to 1, None: unknown) and a description."""
        self._report = report
        self._changed = threading.Condition()
        self._stopped = self._paused = False
        self._steps = 0

    def report(self, share: float | None, what: str) -> None:
        """Report the progress of the job; ignored after it was stopped."""
        if not self._stopped:
            self._report(share, what)

    def describe(self, what: str) -> None:
        """Report what the job does now, its share unknown."""
        self.report(None, what)

    def check(self) -> None:
        """Return at once, or wait while the job is paused; jobs call it several times in a tenth of a second.

        Raises:
            Stopped: the job was stopped; nothing but cleaning up should follow.
        """
        with self._changed:
            while self._paused and not self._steps and not self._stopped:
                self._changed.wait()
            self._steps = max(self._steps - 1, 0)
            if self._stopped:
                raise Stopped

    @property
    def stopped(self) -> bool:
        """Whether the job was stopped."""
        return self._stopped

    @property
    def paused(self) -> bool:
        """Whether the job waits at each check."""
        return self._paused

    def stop(self) -> None:
        """End the job at its next check."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def pause(self, paused: bool) -> None:
        """Pause the job at its next check, or resume it."""
        with self._changed:
            self._paused, self._steps = paused, 0
            self._changed.notify_all()

    def step(self) -> None:
        """Let a paused job pass one check."""
        with self._changed:
            self._steps += 1
            self._changed.notify_all()
