"""Interruption of a command by Ctrl-C, SIGTERM or the closing of its terminal, and of child processes with it."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that interrupt."""

NOTICE_S = 2.0
"""How long (s) compiled code may keep the main thread from raising KeyboardInterrupt."""

_AGAIN_S = 0.05
"""How long (s) an interruption waits that arrives during an import, until it tries again."""

_POLL_S = 0.5
"""How often (s) a child looks for its parent where the kernel does not end both."""

_PR_SET_PDEATHSIG = 1


@contextmanager
def interruptible(end: Callable[[], None]) -> Iterator[Event]:
    """Let SIGNALS raise KeyboardInterrupt in the main thread; yields an event that is set once one did.

    Signals that the caller of this process ignores, as nohup does, stay ignored. During an import nothing is raised:
    some packages catch whatever is raised while they are loaded, and go on.

    Args:
        end: Called in another thread if the main thread is still in compiled code, or imports, NOTICE_S after the first
            signal. Only compiled code that holds the GIL delays it.
    """
    noticed = Event()

    def interrupt(number: int, frame: FrameType | None) -> None:
        importing = _imports(frame)
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S if importing else 0.0)
        if not importing:
            noticed.set()
            raise KeyboardInterrupt

    def watch() -> None:
        # Where the main thread blocks them for a moment, they wait.
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        while number := os.read(read, 1):
            if number[0] in SIGNALS:
                if not noticed.wait(NOTICE_S):
                    end()
                return

    read, write = os.pipe()
    os.set_blocking(write, False)
    wakeup = signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    before = {number: signal.getsignal(number) for number in (*SIGNALS, signal.SIGALRM)}
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, interrupt)
    watcher = Thread(target=watch, name="interruption", daemon=True)
    watcher.start()
    try:
        yield noticed
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(wakeup)
        os.close(write)
        watcher.join()
        os.close(read)


def _imports(frame: FrameType | None) -> bool:
    """Whether a frame is part of an import."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def end_with(parent: int) -> None:
    """Let this process end with the process that started it, whatever ends that one.

    On Linux the kernel kills it, also in the midst of compiled code, when the thread that started it ends. Elsewhere a
    thread finds out, once compiled code lets it run.

    Args:
        parent: Process that started this one.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    else:
        Thread(target=_watch, args=(parent,), name="parent", daemon=True).start()
    if os.getppid() != parent:
        os._exit(1)


def _watch(parent: int) -> None:
    """End this process when it has another parent."""
    while os.getppid() == parent:
        time.sleep(_POLL_S)
    os._exit(1)
