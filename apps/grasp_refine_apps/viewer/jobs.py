"""What takes long: one job at a time in the worker, which may be paused and stopped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.viewer.state import Job, JobKind, State
from grasp_refine_apps.viewer.store import Store
from grasp_refine_apps.viewer.worker import Control, Stopped, Worker

Change = Callable[[State], State]
"""Makes the next state of the present one."""


class Jobs(Store):
    """A store with a worker."""

    def __init__(self, state: State) -> None:
        """Do nothing yet."""
        super().__init__(state)
        self._worker = Worker()
        self._control: Control | None = None

    def close(self) -> None:
        """Stop what is being done, and the worker; what cannot be stopped at once is not waited for long."""
        self._halt()
        self._worker.close(1.0)

    def run_job(self, kind: JobKind, what: str, work: Callable[[Control], Change | None]) -> bool:
        """Do something long in the worker, unless something else is being done; measuring gives way.

        Returns whether it will be done.

        Args:
            kind: What it is for.
            what: What is being done, for people.
            work: Gets a `Control`, whose `check` it calls often; returns what it changes.
        """
        with self._lock:
            if self._state.job is not None and self._state.job.kind != "measure":
                return False
            self._halt()
            control = Control(lambda share, now: self._if_wanted(control, share=share, what=now))
            self._control = control
            self._set(job=Job(kind, what))
            self._worker.do(lambda: self._work(control, work), lambda error: self._failed(control, error))
            return True

    def stop(self) -> None:
        """End what is being done; what it has come to stays."""
        with self._lock:
            self._halt()
            self._ended()

    def _halt(self) -> None:
        """End what is being done, and nothing else."""
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
        """Nothing is being done any more; called with the lock held."""

    def _failed(self, control: Control, error: BaseException) -> None:
        """A job could not be done."""
        with self._lock:
            if control.stopped:
                return
            self._control = None
            self._set(job=None)
            known = isinstance(error, GraspRefineError)
            self.say(str(error) if known else f"this failed ({type(error).__name__}: {error}); see the terminal", True)
            self._ended()

    def _if_wanted(self, control: Control, *, share: float | None = None, what: str = "", **changes: Any) -> None:
        """Change the state on behalf of a job, unless it was stopped meanwhile."""
        with self._lock:
            job = self._state.job
            if control.stopped or control is not self._control or job is None:
                return
            if what:
                changes["job"] = replace(job, what=what, share=share)
            self._set(**changes)

    def _hold(self, paused: bool) -> None:
        if self._control is not None and self._state.job is not None:
            self._control.pause(paused)
            self._set(job=replace(self._state.job, paused=paused))
