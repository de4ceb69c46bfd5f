"""Present state, listeners to new ones, and long jobs: one at a time in the worker, which may be paused and stopped."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from queue import SimpleQueue
from typing import Any, TypeVar

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.viewer.jobs.worker import Control, Stopped
from grasp_refine_apps.viewer.model.state import Job, JobKind, Notice, State

Change = Callable[[State], State]
"""Function from the present state to the next one."""

CLOSE_TIMEOUT_S = 1.0
"""Longest wait for the present job at the end, seconds."""

BUSY_MESSAGE = "another job is running: wait until it ends, or stop it, then try again"
"""Message where a job cannot start."""

Made = TypeVar("Made")


class Store:
    """Keeps the state and runs jobs that change it; the base of the controller."""

    def __init__(self, state: State) -> None:
        """Start with a state, without a job."""
        self._lock = threading.RLock()
        self._listeners: list[Callable[[State], None]] = []
        self._notices = 0
        self._state = state
        self._control: Control | None = None
        self._jobs: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._worker = threading.Thread(target=self._run_jobs, name="viewer worker", daemon=True)
        self._worker.start()

    @property
    def state(self) -> State:
        """The present state; not one within a change, such as between the end of a job and the start of the next."""
        with self._lock:
            return self._state

    def listen(self, listener: Callable[[State], None]) -> None:
        """Call `listener` with every new state; it must return at once and call no command."""
        with self._lock:
            self._listeners.append(listener)

    def notify(self, text: str, bad: bool = False) -> None:
        """Show a message to the user."""
        with self._lock:
            self._notices += 1
            self._set(notice=Notice(self._notices, text, bad))

    def close(self) -> None:
        """Stop the running job and the worker; waits only briefly for a job that does not stop at once."""
        self._halt()
        self._jobs.put(None)
        self._worker.join(CLOSE_TIMEOUT_S)

    def run_job(self, kind: JobKind, what: str, work: Callable[[Control], Change | None]) -> bool:
        """Start a job in the worker, unless another one is running; measuring is stopped for it.

        Returns whether it was started.

        Args:
            kind: Kind of the job.
            what: Description of the job for users.
            work: Called with a `Control`, whose `check` it calls often; returns its change of the state.
        """
        with self._lock:
            if self._state.job is not None and self._state.job.kind != "measure":
                return False
            self._halt()
            control = Control(lambda share, now: self._update_from_job(control, share=share, what=now))
            self._control = control
            self._set(job=Job(kind, what))
            self._jobs.put(partial(self._work, control, work))
            return True

    def stop(self) -> None:
        """Stop the running job; its intermediate result stays."""
        with self._lock:
            self._halt()
            self._ended()

    def _halt(self) -> None:
        """Stop the running job, and nothing else."""
        with self._lock:
            control, self._control = self._control, None
            if control is not None:
                control.stop()
            if self._state.job is not None:
                self._set(job=None)

    def _run_jobs(self) -> None:
        """Do one job after the other; those before it have usually been stopped then."""
        while (job := self._jobs.get()) is not None:
            job()

    def _work(self, control: Control, work: Callable[[Control], Change | None]) -> None:
        """Do a job, and make its change of the state unless it was stopped; a failure is reported to the user."""
        failure = ""
        try:
            change = None if control.stopped else work(control)
            with self._lock:
                if change is not None and not control.stopped:
                    self._become(change(self._state))
        except Stopped:
            return
        except GraspRefineError as error:
            failure = str(error)
        except Exception as error:  # noqa: BLE001 - a job that fails must not end all others; the user is told
            traceback.print_exc()
            failure = f"this failed ({type(error).__name__}: {error}); see the terminal"
        with self._lock:
            if control.stopped:
                return
            self._control = None
            self._set(job=None)
            if failure:
                self.notify(failure, bad=True)
            self._ended()

    def _ended(self) -> None:
        """Hook for the end of a job; called with the lock held."""

    def _update_from_job(self, control: Control, *, share: float | None = None, what: str = "", **changes: Any) -> None:
        """Change the state on behalf of a job, unless it was stopped meanwhile."""
        with self._lock:
            if control is not self._control:
                return
            if what and self._state.job is not None:
                changes["job"] = replace(self._state.job, what=what, share=share)
            self._set(**changes)

    def _hold(self, paused: bool) -> None:
        if self._control is not None and self._state.job is not None:
            self._control.pause(paused)
            self._set(job=replace(self._state.job, paused=paused))

    def _checked(self, make: Callable[[], Made]) -> Made | None:
        """Return what `make` returns; None where it refuses, of which the user is notified."""
        try:
            return make()
        except GraspRefineError as error:
            self.notify(str(error), bad=True)
            return None

    def _set(self, **changes: Any) -> None:
        with self._lock:
            self._become(self._state.evolve(**changes))

    def _become(self, state: State) -> None:
        """Make a state the present one, and call all listeners."""
        with self._lock:
            self._state = replace(state, change=self._state.change + 1)
            for listener in self._listeners:
                listener(self._state)
