"""One thread that does what takes long, one job at a time; jobs are paused, taken step by step, and stopped."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from queue import SimpleQueue


class Stopped(Exception):
    """The user does not want this any more."""


class Control:
    """How one job is told what to do, and tells how far it is; for both threads."""

    def __init__(self, tell: Callable[[float | None, str], None]) -> None:
        """`tell` hears which share (0 to 1, None: unknown) is done, and what is being done."""
        self._tell = tell
        self._changed = threading.Condition()
        self._stopped = self._paused = False
        self._steps = 0

    def tell(self, share: float | None, what: str) -> None:
        """Say how far the job is; what a stopped one says is not heard."""
        if not self._stopped:
            self._tell(share, what)

    def check(self) -> None:
        """Go on, or wait while the job is paused; jobs call it several times in a tenth of a second.

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
        """Whether nobody wants the result any more."""
        return self._stopped

    @property
    def paused(self) -> bool:
        """Whether it is to wait after each check."""
        return self._paused

    def stop(self) -> None:
        """End the job at its next check."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def pause(self, paused: bool) -> None:
        """Hold the job at its next check, or let it go on."""
        with self._changed:
            self._paused, self._steps = paused, 0
            self._changed.notify_all()

    def step(self) -> None:
        """Let a paused job pass one check."""
        with self._changed:
            self._steps += 1
            self._changed.notify_all()


class Worker:
    """The thread; jobs wait for those before them, which have usually been stopped then."""

    def __init__(self) -> None:
        """Wait for jobs."""
        self._jobs: SimpleQueue[tuple[Callable[[], None], Callable[[BaseException], None]] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="viewer worker", daemon=True)
        self._thread.start()

    def do(self, job: Callable[[], None], failed: Callable[[BaseException], None]) -> None:
        """Do a job when those before it are done; `failed` gets what it raises, but for `Stopped`."""
        self._jobs.put((job, failed))

    def close(self, timeout: float = 5.0) -> None:
        """End the thread after the present job, which should have been stopped; wait for it so many seconds."""
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
