"""Worker process of a batch: works on the shards that it receives, and ends with the process that sends them."""

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

HEARTBEAT_INTERVAL_S = 0.2
"""Shortest interval between heartbeats of a worker, seconds; those between are not sent."""

TRACEBACK_SIGNAL = signal.SIGUSR1
"""Signal on which a worker writes its traceback into its log, whatever it does."""


class Ready:
    """Message of a worker that it takes shards."""


def work_on_shards(connection: Connection, work: bytes, log: Connection, parent: int) -> None:
    """Work on each shard that comes in, until SIGTERM or until the other end closes.

    Args:
        connection: Connection; shards come in, and Ready, heartbeats and the result of each shard go out.
        work: The pickled `Work`.
        log: An open file, passed as if it were a connection. Takes both output streams and, at a crash, its traceback.
        parent: Process id with which this process ends.
    """
    # Processes that the work starts are of the same group, so that the parent can end them with this process.
    os.setpgid(0, 0)
    end_with(parent)
    _redirect_output(log)
    signal.signal(signal.SIGTERM, _unwind)
    # An interrupt of all processes of a session is meant for the parent, which ends this one.
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
            # If this shard crashes, only the output since its start is of interest.
            os.ftruncate(2, 0)
            shard: Shard = pickle.loads(received)
            channel.start()
            channel.say(attempt(function, shard, channel.heartbeat))
    except _TerminatedError:
        os._exit(128 + signal.SIGTERM)
    except (BrokenPipeError, ConnectionResetError):
        os._exit(1)


class _TerminatedError(BaseException):
    """Termination by SIGTERM, raised wherever the work is, so that it removes partial files."""


def _unwind(number: int, frame: FrameType | None) -> NoReturn:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise _TerminatedError


def _redirect_output(log: Connection) -> None:
    """Redirect all output of this process into an open file, which may be truncated at any time."""
    fcntl.fcntl(log.fileno(), fcntl.F_SETFL, os.O_APPEND)
    for stream in (1, 2):
        os.dup2(log.fileno(), stream)
    log.close()
    faulthandler.enable(2, all_threads=False)
    faulthandler.register(TRACEBACK_SIGNAL, 2, all_threads=False)


def _receive(connection: Connection, inbox: SimpleQueue[bytes]) -> None:
    """Forward incoming shards; end the process, and all that it has started, when the other end closes."""
    try:
        while True:
            inbox.put(connection.recv_bytes())
    except (EOFError, OSError):
        os.killpg(0, signal.SIGKILL)


class _Channel:
    """Messages of this process to the parent."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._lock = Lock()
        self._last_sent_s = -HEARTBEAT_INTERVAL_S
        self._writable = select.poll()
        self._writable.register(connection, select.POLLOUT)

    def start(self) -> None:
        """Begin a shard: its first heartbeat is always sent."""
        self._last_sent_s = -HEARTBEAT_INTERVAL_S

    def say(self, message: Ready | Sign | Done | Failed) -> None:
        """Send a message, however long that takes."""
        with self._lock:
            self._connection.send(message)

    def heartbeat(self, what: str, share: float, refined: int = 0) -> None:
        """Send a heartbeat, unless the last one was just now or the parent is too busy to receive it."""
        now = time.monotonic()
        if now - self._last_sent_s >= HEARTBEAT_INTERVAL_S and self._writable.poll(0):
            self._last_sent_s = now
            self.say((what, float(share), int(refined)))
