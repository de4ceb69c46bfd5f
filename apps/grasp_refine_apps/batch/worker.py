"""What a worker process of a batch does: works on the shards that it is sent, and ends with whoever sends them."""

from __future__ import annotations

import faulthandler
import fcntl
import os
import pickle
import select
import signal
import time
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import Lock, Thread
from types import FrameType
from typing import NoReturn

from grasp_refine.core.interruption import end_with
from grasp_refine_apps.batch.attempt import attempt
from grasp_refine_apps.batch.shard import Done, Failed, Shard, Sign, Work

BEAT_S = 0.2
"""Signs of life of a worker are at least this far apart; those between are not sent."""

WHERE = signal.SIGUSR1
"""On this signal a worker writes into its log where it is, whatever it does."""


class Ready:
    """A worker says that it takes shards."""


def work_on_shards(connection: Connection, work: bytes, log: Connection, parent: int) -> None:
    """Work on each shard that comes in, until told to end by SIGTERM or until nobody is at the other end.

    Args:
        connection: Shards come in; out go Ready, signs of life, and what came of each shard.
        work: The pickled `Work`.
        log: An open file, handed over as if it were a connection. Takes both output streams and, at a crash, where it
            happens.
        parent: Process with which this one ends.
    """
    # What the work starts in turn is of the same group, so that the parent can end it with this process.
    os.setpgid(0, 0)
    end_with(parent)
    _write_into(log)
    signal.signal(signal.SIGTERM, _unwind)
    # Who interrupts all processes of a session means the parent, which ends this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, signal.SIGTERM))
        inbox: SimpleQueue[bytes] = SimpleQueue()
        Thread(target=_receive, args=(connection, inbox), daemon=True).start()
        function: Work = pickle.loads(work)
        channel = _Channel(connection)
        channel.say(Ready())
        while True:
            received = inbox.get()
            # If this shard ends badly, only what was written since is of interest.
            os.ftruncate(2, 0)
            shard: Shard = pickle.loads(received)
            channel.start()
            channel.say(attempt(function, shard, channel.heartbeat))
    except _ToldToEndError:
        os._exit(128 + signal.SIGTERM)
    except (BrokenPipeError, ConnectionResetError):
        os._exit(1)


class _ToldToEndError(BaseException):
    """Raised on SIGTERM wherever the work is, so that it takes away what it has half written."""


def _unwind(number: int, frame: FrameType | None) -> NoReturn:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise _ToldToEndError


def _write_into(log: Connection) -> None:
    """Let everything that this process says go into an open file, which may be emptied at any time."""
    fcntl.fcntl(log.fileno(), fcntl.F_SETFL, os.O_APPEND)
    for stream in (1, 2):
        os.dup2(log.fileno(), stream)
    log.close()
    faulthandler.enable(2, all_threads=False)
    faulthandler.register(WHERE, 2, all_threads=False)


def _receive(connection: Connection, inbox: SimpleQueue[bytes]) -> None:
    """Hand on what comes in; ends the process, and what it has started, when nobody is at the other end any more."""
    try:
        while True:
            inbox.put(connection.recv_bytes())
    except (EOFError, OSError):
        os.killpg(0, signal.SIGKILL)


class _Channel:
    """What the parent hears of this process."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._lock = Lock()
        self._heard = -BEAT_S
        self._writable = select.poll()
        self._writable.register(connection, select.POLLOUT)

    def start(self) -> None:
        """A shard begins: its first sign of life is sent."""
        self._heard = -BEAT_S

    def say(self, message: Ready | Sign | Done | Failed) -> None:
        """Send it, however long that takes."""
        with self._lock:
            self._connection.send(message)

    def heartbeat(self, what: str, share: float, refined: int = 0) -> None:
        """Give a sign of life, unless the last one was just now or the parent has no time to hear any."""
        now = time.monotonic()
        if now - self._heard >= BEAT_S and self._writable.poll(0):
            self._heard = now
            self.say((what, float(share), int(refined)))
