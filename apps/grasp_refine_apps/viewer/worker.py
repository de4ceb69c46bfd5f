"""Worker thread for long jobs, one at a time; jobs can be paused, stepped and stopped."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from queue import SimpleQueue


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


class Worker:
    """Worker thread; jobs wait for those before them, which have usually been stopped then."""

    def __init__(self) -> None:
        """Start the thread."""
        self._jobs: SimpleQueue[tuple[Callable[[], None], Callable[[BaseException], None]] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="viewer worker", daemon=True)
        self._thread.start()

    def do(self, job: Callable[[], None], failed: Callable[[BaseException], None]) -> None:
        """Do a job after those before it; `failed` is called with its exception, except `Stopped`."""
        self._jobs.put((job, failed))

    def close(self, timeout: float = 5.0) -> None:
        """End the thread after the present job, which should have been stopped; wait at most `timeout` seconds."""
        self._jobs.put(None)
        self._thread.join(timeout)

    def _run(self) -> None:
        while (entry := self._jobs.get()) is not None:
            job, failed = entry
            try:
                job()
            except Stopped:
                pass
            except Exception as error:  # noqa: BLE001 - a job that fails must not end all others; the user is told
                traceback.print_exc()
                failed(error)
