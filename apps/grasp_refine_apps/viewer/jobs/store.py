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
from grasp_refine_apps.viewer.model.sharing import with_shared
from grasp_refine_apps.viewer.model.state import Job, JobKind, Notice, State

Change = Callable[[State], State]
"""Function from the present state to the next one."""

CLOSE_TIMEOUT_S = 1.0
"""Longest wait for the present job at the end, seconds."""

BUSY_MESSAGE = "another job is running: wait until it ends, or stop it, then try again"
"""Message where a job cannot start."""

Made = TypeVar("Made")


class Store:
    """Present state, with the one worker whose jobs change it; several stores may share the work on grasps."""

    def __init__(self, state: State, beside: Store | None = None) -> None:
        """Start with a state, without a job; share the work of `beside`, and of all that do."""
        self.lock = threading.RLock()
        self._sharing: list[Store] = []
        if beside is not None:
            self.lock, self._sharing = beside.lock, beside._sharing
        self._sharing.append(self)
        self._listeners: list[Callable[[State], None]] = []
        self._notices = 0
        self._state = state
        self._control: Control | None = None
        self._jobs: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._worker = threading.Thread(target=self._run_jobs, name="viewer worker", daemon=True)
        self._worker.start()
        self.on_stop: Callable[[Job | None], None] = lambda job: None
        """Called with the job that the user stops, the lock held."""
        self.on_idle: Callable[[], None] = lambda: None
        """Called when the worker is free again, the lock held."""

    @property
    def state(self) -> State:
        """The present state; not one within a change, such as between the end of a job and the start of the next."""
        with self.lock:
            return self._state

    def runs_elsewhere(self, kind: JobKind) -> bool:
        """Return whether another page runs a job of this kind for the grasp that is shown here."""
        with self.lock:
            return any(
                other is not self
                and other._state.job is not None
                and other._state.job.kind == kind
                and other._state.number == self._state.number
                and other._state.collection.same_grasps(self._state.collection)
                for other in self._sharing
            )

    def unlisten(self, listener: Callable[[State], None]) -> None:
        """Call `listener` no more."""
        with self.lock:
            self._listeners.remove(listener)

    def listen(self, listener: Callable[[State], None]) -> None:
        """Call `listener` with every new state; it must return at once and call no command."""
        with self.lock:
            self._listeners.append(listener)

    def notify(self, text: str, bad: bool = False) -> None:
        """Show a message to the user."""
        with self.lock:
            self._notices += 1
            self.set(notice=Notice(self._notices, text, bad))

    def close(self) -> None:
        """Stop the running job and the worker; waits only briefly for a job that does not stop at once."""
        self.halt()
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
        with self.lock:
            if self._state.job is not None and self._state.job.kind != "measure":
                return False
            self.halt()
            control = Control(lambda share, now: self.update_from_job(control, share=share, what=now))
            self._control = control
            self.set(job=Job(kind, what))
            self._jobs.put(partial(self._work, control, work))
            return True

    def stop(self) -> None:
        """Stop the running job; its intermediate result stays."""
        with self.lock:
            self.on_stop(self._state.job)
            self.halt()
            self.on_idle()

    def halt(self) -> None:
        """Stop the running job, and nothing else."""
        with self.lock:
            control, self._control = self._control, None
            if control is not None:
                control.stop()
            if self._state.job is not None:
                self.set(job=None)

    def _run_jobs(self) -> None:
        """Run one job after the other; earlier jobs have usually been stopped."""
        while (job := self._jobs.get()) is not None:
            job()

    def _work(self, control: Control, work: Callable[[Control], Change | None]) -> None:
        """Do a job, and make its change of the state unless it was stopped; a failure is reported to the user."""
        failure = ""
        try:
            change = None if control.stopped else work(control)
            with self.lock:
                if change is not None and not control.stopped:
                    self.become(change(self._state))
        except Stopped:
            return
        except GraspRefineError as error:
            failure = str(error)
        except Exception as error:  # noqa: BLE001 - a job that fails must not end all others; the user is notified
            traceback.print_exc()
            failure = f"this failed ({type(error).__name__}: {error}); see the terminal"
        with self.lock:
            if control.stopped:
                return
            self._control = None
            self.set(job=None)
            if failure:
                self.notify(failure, bad=True)
            self.on_idle()

    def update_from_job(self, control: Control, *, share: float | None = None, what: str = "", **changes: Any) -> None:
        """Change the state on behalf of a job, unless it was stopped meanwhile."""
        with self.lock:
            if control is not self._control:
                return
            if what and self._state.job is not None:
                changes["job"] = replace(self._state.job, what=what, share=share)
            self.set(**changes)

    def hold(self, paused: bool) -> None:
        """Pause the running job, or resume it."""
        with self.lock:
            if self._control is not None and self._state.job is not None:
                self._control.pause(paused)
                self.set(job=replace(self._state.job, paused=paused))

    def step(self) -> None:
        """Let a paused job go on to its next check."""
        with self.lock:
            if self._control is not None:
                self._control.step()

    def checked(self, make: Callable[[], Made]) -> Made | None:
        """Return the result of `make`; None where it refuses, and the user is notified."""
        try:
            return make()
        except GraspRefineError as error:
            self.notify(str(error), bad=True)
            return None

    def set(self, **changes: Any) -> None:
        """Set fields of the state, or of the work on the shown grasp."""
        with self.lock:
            self.become(self._state.evolve(**changes))

    def become(self, state: State) -> None:
        """Make a state the present one, share its work, and call all listeners."""
        with self.lock:
            before = self._state
            self._show(state)
            for other in self._sharing:
                shared = other._state if other is self else with_shared(other._state, before, state)
                if shared is not other._state:
                    other._show(shared)

    def _show(self, state: State) -> None:
        self._state = replace(state, change=self._state.change + 1)
        for listener in self._listeners:
            listener(self._state)
