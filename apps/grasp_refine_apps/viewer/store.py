"""Present state, listeners to new ones, and long jobs: one at a time in the worker, which may be paused and stopped."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.viewer.state import Job, JobKind, Notice, State
from grasp_refine_apps.viewer.worker import Control, Stopped, Worker

Change = Callable[[State], State]
"""Function from the present state to the next one."""

Made = TypeVar("Made")


class Store:
    """Keeps the state and runs jobs that change it; the base of the controller."""

    def __init__(self, state: State) -> None:
        """Start with a state, without a job."""
        self._lock = threading.RLock()
        self._listeners: list[Callable[[State], None]] = []
        self._notices = 0
        self._state = state
        self._worker = Worker()
        self._control: Control | None = None

    @property
    def state(self) -> State:
        """The present state."""
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
        self._worker.close(1.0)

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
            self._worker.do(lambda: self._work(control, work), lambda error: self._failed(control, error))
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

    def _work(self, control: Control, work: Callable[[Control], Change | None]) -> None:
        if control.stopped:
            return
        try:
            change = work(control)
        except GraspRefineError as error:
            if not control.stopped:
                self._failed(control, error)
            return
        with self._lock:
            if control.stopped:
                raise Stopped
            self._control = None
            self._become(replace(self._state if change is None else change(self._state), job=None))
            self._ended()

    def _ended(self) -> None:
        """Hook for the end of a job; called with the lock held."""

    def _failed(self, control: Control, error: BaseException) -> None:
        """Report a failed job."""
        with self._lock:
            if control.stopped:
                return
            self._control = None
            self._set(job=None)
            known = isinstance(error, GraspRefineError)
            self.notify(
                str(error) if known else f"this failed ({type(error).__name__}: {error}); see the terminal", True
            )
            self._ended()

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
            self._become(replace(self._state, **changes))

    def _become(self, state: State) -> None:
        """Make a state the present one, and call all listeners."""
        with self._lock:
            self._state = replace(state, change=self._state.change + 1)
            for listener in self._listeners:
                listener(self._state)
