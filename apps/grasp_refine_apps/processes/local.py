"""Worker processes of this machine: one that crashes or hangs is replaced, and the others go on.

They are processes of `multiprocessing`, with a pipe each, because the pools that others keep do less: all tasks of
`ProcessPoolExecutor` and of loky end when one worker crashes; Pebble (LGPL) has no heartbeats; Dask's local cluster is
14 packages, starts in 1.5 s instead of 0.15 s, takes 64 MB for an idle worker instead of 16 MB, and does not report by
which signal, and where in the code, a worker ended.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.processes.dispatch import Lost
from grasp_refine_apps.processes.task import Task, Work
from grasp_refine_apps.processes.worker import TRACEBACK_SIGNAL, Ready, serve

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of workers: the number of workers is the number of threads for linear algebra."""

POLL_INTERVAL_S = 0.5
"""Longest interval between two checks of the workers, seconds."""

SHUTDOWN_LIMIT_S = 2.0
"""Time limit for terminated workers to clean up, seconds."""

TRACEBACK_LIMIT_S = 0.3
"""Time limit for a hanging worker to write its traceback, seconds."""

MAX_FAILED_STARTS = 3
"""Number of workers in a row that end before they take tasks, after which no more are started."""

MAX_LOG_BYTES = 16384
"""Maximum length of the kept log of a lost worker, bytes."""


class LocalPool:
    """Worker processes for one run, named by their process ids.

    Each is spawned, with one thread for linear algebra. When this process dies, so do they. One thread must use the
    pool to its end, because the kernel ends workers with the thread that started them.
    """

    has_queues = False
    """Tasks begin at once."""

    def __init__(self, work: Work, workers: int, patience_s: float | None = None) -> None:
        """Prepare the pool; no worker is started yet.

        Args:
            work: Work function.
            workers: Maximum number of workers; there are never more than tasks.
            patience_s: Longest start of a worker, seconds; None: no limit.
        """
        self._work, self._most, self._patience_s = pickle.dumps(work), workers, patience_s
        self._processes: dict[str, _Process] = {}
        self._failed_starts = 0
        self._last_fault = ""

    def workers(self, wanted: int) -> list[str]:
        """Return the names of the workers that are ready, and start missing ones.

        Raises:
            GraspRefineError: Workers end while they start, and none has started.
        """
        ready = [name for name, process in self._processes.items() if process.ready]
        while len(self._processes) < min(self._most, wanted):
            if self._failed_starts >= MAX_FAILED_STARTS:
                if ready:
                    break  # The started ones do all the work.
                raise GraspRefineError(
                    f"{self._failed_starts} worker processes in a row could not be started: the last {self._last_fault}"
                )
            try:
                process = _Process(self._work)
                self._processes[str(process.pid)] = process
            except OSError as error:
                self._failed_starts += 1
                self._last_fault = f"was refused by the system ({error.strerror or error}): try fewer"
        return ready

    def submit(self, worker: str, task: Task) -> None:
        """Send a task to a worker; if it has just ended, `listen` notices it."""
        with suppress(BrokenPipeError, ConnectionResetError):
            self._processes[worker].connection.send(task)

    def listen(self) -> list[tuple[str, Any]]:
        """Return the messages of workers, after a short wait if there are none; lost ones are ended and forgotten."""
        wait([source for process in self._processes.values() for source in process.sources], POLL_INTERVAL_S)
        messages: list[tuple[str, Any]] = []
        for name, process in list(self._processes.items()):
            was_ready = process.ready
            received, ended = process.receive()
            messages += [(name, message) for message in received]
            late = not process.ready and self._patience_s is not None and process.age_s > self._patience_s
            if process.ready and not was_ready:
                self._failed_starts = 0
            if not (ended or late):
                continue
            del self._processes[name]
            exit_code, log = process.kill()
            lost = Lost(_exit_text(exit_code), log)
            messages.append((name, lost))
            if not process.ready:
                self._failed_starts += 1
                self._last_fault = (
                    ": ".join([lost.cause, *log.splitlines()[-1:]]) + "; `refine-grasp doctor` lists missing packages"
                    if ended
                    else f"took over {self._patience_s:g} s: a busy machine takes more patience"
                )
        return messages

    def restart(self, worker: str) -> str:
        """End a worker, which is replaced when it is needed; return the end of its log, with a traceback."""
        process = self._processes.pop(worker)
        with suppress(ProcessLookupError):
            os.kill(process.pid, TRACEBACK_SIGNAL)
        wait([process.sentinel], TRACEBACK_LIMIT_S)
        return process.kill()[1]

    def close(self) -> None:
        """End all workers, and all processes that they have started."""
        left = {process.sentinel for process in self._processes.values()}
        try:
            for process in self._processes.values():
                process.terminate()
            until = time.monotonic() + SHUTDOWN_LIMIT_S
            while left and time.monotonic() < until:
                left -= set(wait(list(left), max(0.0, until - time.monotonic())))
        finally:
            for process in self._processes.values():
                process.kill()
            self._processes.clear()


class _Process:
    """Worker process, as seen by the process that started it."""

    def __init__(self, work: bytes) -> None:
        """Start the process, which leads a process group of its own, on a pickled work function."""
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        # It has no name, so that nothing is left behind.
        self._log = tempfile.TemporaryFile()
        log = Connection(os.dup(self._log.fileno()), readable=False)
        self._process = context.Process(target=serve, args=(theirs, work, log, os.getpid()), daemon=True)
        with _inherited_settings():
            self._process.start()
        theirs.close()
        log.close()
        assert self._process.pid is not None
        self.pid, self.sentinel, self.terminate = self._process.pid, self._process.sentinel, self._process.terminate
        self.ready = False
        """Whether the worker takes tasks."""
        self._started_s = time.monotonic()

    @property
    def sources(self) -> tuple[Connection, int]:
        """Objects to wait for: the connection of its messages, and the sentinel of its end."""
        return self.connection, self.sentinel

    @property
    def age_s(self) -> float:
        """Time since the start, seconds."""
        return time.monotonic() - self._started_s

    def receive(self) -> tuple[list[Any], bool]:
        """Return the messages since the last call, and whether the process has ended."""
        messages: list[Any] = []
        # Checked first: all messages of an ended process are then there to be received.
        ended = bool(wait([self.sentinel], 0))
        try:
            while self.connection.poll():
                message = self.connection.recv()
                if isinstance(message, Ready):
                    self.ready = True
                else:
                    messages.append(message)
        except (EOFError, ConnectionResetError):
            # It is about to end, with an exit code.
            wait([self.sentinel], SHUTDOWN_LIMIT_S)
            ended = True
        return messages, ended

    def kill(self) -> tuple[int | None, str]:
        """Kill the worker and its processes; return its exit code (None: it does not end) and the end of its log."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.pid, signal.SIGKILL)
        self._process.kill()
        self._process.join(SHUTDOWN_LIMIT_S)
        self.connection.close()
        with self._log:
            size = os.fstat(self._log.fileno()).st_size
            log = os.pread(self._log.fileno(), MAX_LOG_BYTES, max(0, size - MAX_LOG_BYTES))
        return self._process.exitcode, log.decode(errors="replace").strip()


def _exit_text(exit_code: int | None) -> str:
    """Text for the end of a process."""
    if exit_code is None:
        return "stopped responding, and cannot be ended"
    if exit_code >= 0:
        return f"ended with exit code {exit_code}"
    cause = " (by someone, or by the system because memory was short)" if -exit_code == signal.SIGKILL else ""
    return f"was ended by {signal.Signals(-exit_code).name}{cause}"


@contextmanager
def _inherited_settings() -> Iterator[None]:
    """Let processes that are started within inherit ONE_THREAD, and block interrupts until they are ready."""
    # Its first start would unblock the signals again.
    resource_tracker.ensure_running()
    environment = dict(os.environ)
    signals = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        os.environ.update(ONE_THREAD)
        yield
    finally:
        for name in ONE_THREAD:
            del os.environ[name]
        os.environ.update(environment)
        signal.pthread_sigmask(signal.SIG_SETMASK, signals)
