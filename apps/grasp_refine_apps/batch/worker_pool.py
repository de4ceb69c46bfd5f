"""The worker processes of a batch: how they are started, given shards, listened to, found to be lost, and ended."""

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
from grasp_refine_apps.batch.worker import BEAT_S, WHERE, Ready, work_on_shards

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Set to 1 for workers: there are as many of them as there shall be threads."""

LOOK_S = 0.5
"""Workers are looked after at least this often."""

END_S = 2.0
"""How long workers that are told to end may take to clean up."""

WHERE_S = 0.3
"""How long a worker that hangs may take to write down where."""

BAD_STARTS = 3
"""When so many workers in a row end before they take shards, it is no accident."""

_LOG_LINES, _LOG_BYTES, _LINE = 120, 16384, 300
"""What is kept of the log of a lost worker: lines, bytes, and characters of a line."""


class WorkerPool:
    """The worker processes of one batch."""

    def __init__(self, work: Work, most: int, patience_s: float) -> None:
        """None is started yet.

        Args:
            work: What they do with a shard.
            most: How many there may be.
            patience_s: How long they may give no sign of life (s).
        """
        self._most = most
        self._work = pickle.dumps(work)
        self._patience_s = patience_s
        self._members: list[_Worker] = []
        self._clock_s = 0.0
        """How long workers were listened to, so that a pause of this process alone makes nobody look dead."""
        self._looked = time.monotonic()
        self._bad_starts = 0
        self._why = ""

    @property
    def busy(self) -> int:
        """How many have a shard."""
        return sum(member.shard is not None for member in self._members)

    def share_out(self, schedule: Schedule) -> None:
        """Give every worker that has nothing to do a shard, as long as there are any, and start those that are missing.

        Raises:
            GraspRefineError: Workers end while they start, and there is none that has started.
        """
        for member in self._members:
            if member.ready and member.shard is None and (shard := schedule.take(member.group)) is not None:
                member.give(shard, self._clock_s)
        while len(self._members) < min(self._most, self.busy + len(schedule)):
            if self._bad_starts >= BAD_STARTS:
                if any(member.ready for member in self._members):
                    return  # Those that are there do all the work.
                raise GraspRefineError(
                    f"{self._bad_starts} worker processes in a row could not be started: the last {self._why}"
                )
            try:
                self._members.append(_Worker(self._work, self._clock_s))
            except OSError as error:
                self._bad_starts += 1
                self._why = f"was refused by the system ({error.strerror or error}): try fewer"

    def listen(self) -> list[Event]:
        """What was heard about shards, after a short wait if need be; lost workers are ended and forgotten."""
        wait([source for member in self._members for source in member.sources], LOOK_S)
        now = time.monotonic()
        self._clock_s += min(now - self._looked, 2 * LOOK_S)
        self._looked = now
        news: list[Event] = []
        for member in list(self._members):
            news += member.hear(self._clock_s)
            if member.ready:
                self._bad_starts = 0
            loss = member.loss(self._clock_s, self._patience_s)
            if loss is None:
                continue
            self._members.remove(member)
            if member.shard is not None:
                news.append((member.shard, loss))
            elif not member.ready:
                self._bad_starts += 1
                self._why = loss.message.removeprefix("its worker ")
                if loss.reason == "hung":
                    self._why += ": a busy machine takes more patience"
                else:
                    said = ": ".join(["", *loss.traceback.splitlines()[-1:]])
                    self._why += f"{said}; `refine-grasp doctor` says what is missing here"
        return news

    def end(self) -> None:
        """End all of them, and whatever they have started."""
        try:
            for member in self._members:
                member.tell_to_end()
            until = time.monotonic() + END_S
            while (left := [member for member in self._members if not member.gone]) and time.monotonic() < until:
                wait([member.sources[1] for member in left], max(0.0, until - time.monotonic()))
        finally:
            for member in self._members:
                member.kill()
            self._members.clear()


class _Worker:
    """A worker process, as seen by who started it."""

    def __init__(self, work: bytes, clock_s: float) -> None:
        """Start it.

        Args:
            work: The pickled work function.
            clock_s: The time now.
        """
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        # It has no name, so that nothing of it can stay behind.
        self._log = tempfile.TemporaryFile()
        log = Connection(os.dup(self._log.fileno()), readable=False)
        self._process = context.Process(target=work_on_shards, args=(theirs, work, log, os.getpid()), daemon=True)
        with _one_thread(), _uninterrupted():
            self._process.start()
        theirs.close()
        log.close()
        self.ready = False
        """Whether it takes shards."""
        self.shard: Shard | None = None
        """What it works on."""
        self.group: str | None = None
        """The group of its last shard."""
        self._doing: Sign | None = None
        self._heard_s = clock_s
        self._over = False

    @property
    def sources(self) -> tuple[Connection, int]:
        """What can be waited for: its messages, and its end."""
        return self._connection, self._process.sentinel

    @property
    def gone(self) -> bool:
        """Whether the process has ended."""
        return bool(wait([self._process.sentinel], 0))

    def give(self, shard: Shard, clock_s: float) -> None:
        """Let it work on a shard."""
        self.shard, self.group, self._doing, self._heard_s = shard, shard.group, None, clock_s
        # That it has just ended comes out when it is listened to.
        with suppress(BrokenPipeError, ConnectionResetError):
            self._connection.send(shard)

    def hear(self, clock_s: float) -> list[Event]:
        """What it has said about its shard since."""
        news: list[Event] = []
        # Asked first: what a process said before it ended is all there to be heard.
        self._over = self.gone
        try:
            while self._connection.poll():
                said = self._connection.recv()
                self._heard_s = clock_s
                if isinstance(said, Ready):
                    self.ready = True
                elif self.shard is not None:
                    news.append((self.shard, said))
                    if isinstance(said, tuple):
                        self._doing = said
                    else:
                        self.shard = None
        except (EOFError, ConnectionResetError):
            self._over = True
        return news

    def loss(self, clock_s: float, patience_s: float) -> Failed | None:
        """How it was lost, if it was; then nothing is left of it."""
        number = -1 if self.shard is None else self.shard.number
        if self._over:
            exit_code, log = self.kill()
            return Failed(number, "crashed", f"its worker {_way_out(exit_code)}{self._last_sign()}", log, tries=1)
        # Signs of life may have been given, and not sent, for a moment after the last one that was.
        if (self.shard is None and self.ready) or clock_s - self._heard_s <= patience_s + BEAT_S:
            return None
        with suppress(ProcessLookupError):
            os.kill(self._number, WHERE)
        wait([self._process.sentinel], WHERE_S)
        _, log = self.kill()
        message = f"its worker gave no sign of life for {patience_s:g} s{self._last_sign()}"
        return Failed(number, "hung", message, log, tries=1)

    def tell_to_end(self) -> None:
        """Ask it to clean up and end."""
        self._process.terminate()

    def kill(self) -> tuple[int | None, str]:
        """End it, and what it has started, at once; its exit code (None: it does not end), and the end of its log."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._number, signal.SIGKILL)
        self._process.kill()
        self._process.join(END_S)
        self._connection.close()
        with self._log:
            size = os.fstat(self._log.fileno()).st_size
            text = os.pread(self._log.fileno(), _LOG_BYTES, max(0, size - _LOG_BYTES)).decode(errors="replace")
        lines = (line[:_LINE] for line in text.strip().splitlines()[-_LOG_LINES:])
        return self._process.exitcode, "\n".join(lines)

    @property
    def _number(self) -> int:
        """That of the process, and of the group of processes that it leads."""
        assert self._process.pid is not None
        return self._process.pid

    def _last_sign(self) -> str:
        """What it was doing when last heard of."""
        if self._doing is None:
            return "" if self.ready else " while it started"
        what, share, _ = self._doing
        return f" at {share:.0%} of the shard: {what}"


def _way_out(exit_code: int | None) -> str:
    """How a process ended."""
    if exit_code is None:
        return "fell silent, and cannot be ended"
    if exit_code >= 0:
        return f"ended with exit code {exit_code}"
    cause = " (by someone, or by the system because memory was short)" if -exit_code == signal.SIGKILL else ""
    return f"was ended by {signal.Signals(-exit_code).name}{cause}"


@contextmanager
def _one_thread() -> Iterator[None]:
    """Processes started within use one thread for linear algebra."""
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
def _uninterrupted() -> Iterator[None]:
    """Processes started within are not interrupted until they are ready for it; this one only afterwards."""
    # Its first start would undo what is blocked here.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
