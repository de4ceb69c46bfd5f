"""Worker process: works on the tasks that it receives, and ends with the process that sends them."""

from __future__ import annotations

import faulthandler
import fcntl
import os
import pickle
import signal
from multiprocessing.connection import Connection
from types import FrameType
from typing import NoReturn

from grasp_refine.core.interruption import end_with
from grasp_refine_apps.processes.task import Work, attempt

HEARTBEAT_INTERVAL_S = 0.2
"""Shortest interval between heartbeats of a worker, seconds."""

TRACEBACK_SIGNAL = signal.SIGUSR1
"""Signal on which a worker writes its traceback into its log, whatever it does."""


class Ready:
    """Message of a worker that it takes tasks."""


def serve(connection: Connection, work: bytes, log: Connection, parent: int) -> None:
    """Work on each task that comes in, until SIGTERM or until the other end closes.

    Args:
        connection: Connection; tasks come in, and Ready, heartbeats and the result of each task go out.
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
        function: Work = pickle.loads(work)
        connection.send(Ready())
        while True:
            received = connection.recv_bytes()
            # If this task crashes, only the output since its start is of interest.
            os.ftruncate(2, 0)
            connection.send(attempt(function, pickle.loads(received), connection.send, HEARTBEAT_INTERVAL_S))
    except _TerminatedError:
        os._exit(128 + signal.SIGTERM)
    except (EOFError, BrokenPipeError, ConnectionResetError):
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
