"""Pool of the worker processes of a batch: start, distribution of shards, messages, detection of losses, end."""

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

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.batch.dispatch import Event
from grasp_refine_apps.batch.schedule import Schedule
from grasp_refine_apps.batch.shard import Failed, Shard, Sign, Work
from grasp_refine_apps.batch.worker import HEARTBEAT_INTERVAL_S, TRACEBACK_SIGNAL, Ready, work_on_shards

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables set to 1 for workers: the number of workers is the number of threads."""

POLL_INTERVAL_S = 0.5
"""Longest interval between two checks of the workers, seconds."""

SHUTDOWN_LIMIT_S = 2.0
"""Time limit for terminated workers to clean up, seconds."""

TRACEBACK_LIMIT_S = 0.3
"""Time limit for a hanging worker to write its traceback, seconds."""

MAX_FAILED_STARTS = 3
"""Number of workers in a row that end before they take shards, after which no more are started."""

_LOG_LINES, _LOG_BYTES, _LINE_CHARACTERS = 120, 16384, 300
"""Limits of the kept log of a lost worker: lines, bytes, and characters of a line."""


class WorkerPool:
    """Worker processes of one batch."""

    def __init__(self, work: Work, most: int, patience_s: float) -> None:
        """Prepare the pool; no worker is started yet.

        Args:
            work: Work function for a shard.
            most: Maximum number of workers.
            patience_s: Longest time without a heartbeat, seconds.
        """
        self._most = most
        self._work = pickle.dumps(work)
        self._patience_s = patience_s
        self._members: list[_Worker] = []
        self._clock_s = 0.0
        """Time spent listening to workers, seconds: a pause of this process makes no worker look dead."""
        self._last_poll = time.monotonic()
        self._failed_starts = 0
        self._last_fault = ""

    @property
    def busy(self) -> int:
        """Number of workers that have a shard."""
        return sum(member.shard is not None for member in self._members)

    def share_out(self, schedule: Schedule) -> None:
        """Give a shard to every idle worker, as long as there are any, and start missing workers.

        Raises:
            GraspRefineError: Workers end while they start, and none has started.
        """
        for member in self._members:
            if member.ready and member.shard is None and (shard := schedule.take(member.group)) is not None:
                member.give(shard, self._clock_s)
        while len(self._members) < min(self._most, self.busy + len(schedule)):
            if self._failed_starts >= MAX_FAILED_STARTS:
                if any(member.ready for member in self._members):
                    return  # The started ones do all the work.
                raise GraspRefineError(
                    f"{self._failed_starts} worker processes in a row could not be started: the last {self._last_fault}"
                )
            try:
                self._members.append(_Worker(self._work, self._clock_s))
            except OSError as error:
                self._failed_starts += 1
                self._last_fault = f"was refused by the system ({error.strerror or error}): try fewer"

    def listen(self) -> list[Event]:
        """Return the events of shards, after a short wait if there are none; lost workers are ended and forgotten."""
        wait([source for member in self._members for source in member.sources], POLL_INTERVAL_S)
        now = time.monotonic()
        self._clock_s += min(now - self._last_poll, 2 * POLL_INTERVAL_S)
        self._last_poll = now
        events: list[Event] = []
        for member in list(self._members):
            events += member.receive(self._clock_s)
            if member.ready:
                self._failed_starts = 0
            loss = member.loss(self._clock_s, self._patience_s)
            if loss is None:
                continue
            self._members.remove(member)
            if member.shard is not None:
                events.append((member.shard, loss))
            elif not member.ready:
                self._failed_starts += 1
                self._last_fault = loss.message.removeprefix("its worker ")
                if loss.reason == "hung":
                    self._last_fault += ": a busy machine takes more patience"
                else:
                    cause = ": ".join(["", *loss.traceback.splitlines()[-1:]])
                    self._last_fault += f"{cause}; `refine-grasp doctor` lists what is missing here"
        return events

    def end(self) -> None:
        """End all workers, and all processes that they have started."""
        try:
            for member in self._members:
                member.terminate()
            until = time.monotonic() + SHUTDOWN_LIMIT_S
            while (left := [member for member in self._members if not member.gone]) and time.monotonic() < until:
                wait([member.sources[1] for member in left], max(0.0, until - time.monotonic()))
        finally:
            for member in self._members:
                member.kill()
            self._members.clear()


class _Worker:
    """Worker process, as seen by the process that started it."""

    def __init__(self, work: bytes, clock_s: float) -> None:
        """Start the process.

        Args:
            work: The pickled work function.
            clock_s: Current time on the clock of the pool, seconds.
        """
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        # It has no name, so that nothing is left behind.
        self._log = tempfile.TemporaryFile()
        log = Connection(os.dup(self._log.fileno()), readable=False)
        self._process = context.Process(target=work_on_shards, args=(theirs, work, log, os.getpid()), daemon=True)
        with _one_thread(), _interrupts_blocked():
            self._process.start()
        theirs.close()
        log.close()
        self.ready = False
        """Whether the worker takes shards."""
        self.shard: Shard | None = None
        """Current shard; None: the worker is idle."""
        self.group: str | None = None
        """Group of the last shard."""
        self._doing: Sign | None = None
        self._heard_s = clock_s
        self._over = False

    @property
    def sources(self) -> tuple[Connection, int]:
        """Objects to wait for: the connection of its messages, and the sentinel of its end."""
        return self._connection, self._process.sentinel

    @property
    def gone(self) -> bool:
        """Whether the process has ended."""
        return bool(wait([self._process.sentinel], 0))

    def give(self, shard: Shard, clock_s: float) -> None:
        """Send a shard to the worker."""
        self.shard, self.group, self._doing, self._heard_s = shard, shard.group, None, clock_s
        # If it has just ended, `receive` notices it.
        with suppress(BrokenPipeError, ConnectionResetError):
            self._connection.send(shard)

    def receive(self, clock_s: float) -> list[Event]:
        """Return the events of its shard since the last call."""
        events: list[Event] = []
        # Checked first: all messages of an ended process are then there to be received.
        self._over = self.gone
        try:
            while self._connection.poll():
                message = self._connection.recv()
                self._heard_s = clock_s
                if isinstance(message, Ready):
                    self.ready = True
                elif self.shard is not None:
                    events.append((self.shard, message))
                    if isinstance(message, tuple):
                        self._doing = message
                    else:
                        self.shard = None
        except (EOFError, ConnectionResetError):
            self._over = True
        return events

    def loss(self, clock_s: float, patience_s: float) -> Failed | None:
        """Return the failure of a lost worker, after ending all of its processes; None: it is not lost."""
        number = -1 if self.shard is None else self.shard.number
        if self._over:
            exit_code, log = self.kill()
            return Failed(number, "crashed", f"its worker {_exit_text(exit_code)}{self._last_sign()}", log, tries=1)
        # Heartbeats within the interval after the last one were not sent.
        if (self.shard is None and self.ready) or clock_s - self._heard_s <= patience_s + HEARTBEAT_INTERVAL_S:
            return None
        with suppress(ProcessLookupError):
            os.kill(self._number, TRACEBACK_SIGNAL)
        wait([self._process.sentinel], TRACEBACK_LIMIT_S)
        _, log = self.kill()
        message = f"its worker gave no sign of life for {patience_s:g} s{self._last_sign()}"
        return Failed(number, "hung", message, log, tries=1)

    def terminate(self) -> None:
        """Ask the worker to clean up and end."""
        self._process.terminate()

    def kill(self) -> tuple[int | None, str]:
        """Kill the worker and its processes; return its exit code (None: it does not end) and the end of its log."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._number, signal.SIGKILL)
        self._process.kill()
        self._process.join(SHUTDOWN_LIMIT_S)
        self._connection.close()
        with self._log:
            size = os.fstat(self._log.fileno()).st_size
            text = os.pread(self._log.fileno(), _LOG_BYTES, max(0, size - _LOG_BYTES)).decode(errors="replace")
        lines = (line[:_LINE_CHARACTERS] for line in text.strip().splitlines()[-_LOG_LINES:])
        return self._process.exitcode, "\n".join(lines)

    @property
    def _number(self) -> int:
        """Id of the process, and of the process group that it leads."""
        assert self._process.pid is not None
        return self._process.pid

    def _last_sign(self) -> str:
        """Text for its last heartbeat."""
        if self._doing is None:
            return "" if self.ready else " while it started"
        what, share, _ = self._doing
        return f" at {share:.0%} of the shard: {what}"


def _exit_text(exit_code: int | None) -> str:
    """Text for the end of a process."""
    if exit_code is None:
        return "stopped responding, and cannot be ended"
    if exit_code >= 0:
        return f"ended with exit code {exit_code}"
    cause = " (by someone, or by the system because memory was short)" if -exit_code == signal.SIGKILL else ""
    return f"was ended by {signal.Signals(-exit_code).name}{cause}"


@contextmanager
def _one_thread() -> Iterator[None]:
    """Start processes within with one thread for linear algebra."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block interrupts: processes started within get them once they are ready, this process afterwards."""
    # Its first start would unblock the signals again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
