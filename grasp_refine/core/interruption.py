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

INTERRUPTED = 130
"""Exit code of a command that was interrupted: that of a shell for SIGINT."""

NOTICE_S = 2.0
"""Time (s) that compiled code may keep the main thread from raising KeyboardInterrupt."""

_RETRY_S = 0.05
"""Delay (s) before an interruption that arrives during an import is retried."""

_POLL_S = 0.5
"""Interval (s) at which a child checks for its parent where the kernel does not end both."""

_PR_SET_PDEATHSIG = 1


@contextmanager
def interruptible(end: Callable[[], None]) -> Iterator[Event]:
    """Let SIGNALS raise KeyboardInterrupt(number) in the main thread; yields an event that is set once one did.

    Signals that the caller of this process ignores, as nohup does, stay ignored. During an import nothing is raised:
    some packages catch every exception while they are loaded, and go on.

    Args:
        end: Called in another thread if the main thread is still in compiled code, or imports, NOTICE_S after the first
            signal. Only compiled code that holds the GIL delays it.
    """
    noticed = Event()

    def interrupt(number: int, frame: FrameType | None) -> None:
        importing = _is_importing(frame)
        signal.setitimer(signal.ITIMER_REAL, _RETRY_S if importing else 0.0)
        if not importing:
            noticed.set()
            raise KeyboardInterrupt(number)

    def watch() -> None:
        # Signals wait while the main thread blocks them.
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


def _is_importing(frame: FrameType | None) -> bool:
    """Return whether a frame is part of an import."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def end_with(parent: int) -> None:
    """Make this process end with the process that started it, however that one ends.

    On Linux the kernel kills it, even in compiled code, when the thread that started it ends. Elsewhere a thread polls
    for the parent, as soon as compiled code releases the GIL.

    Args:
        parent: Id of the process that started this one.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    else:
        Thread(target=_watch, args=(parent,), name="parent", daemon=True).start()
    if os.getppid() != parent:
        os._exit(1)


def _watch(parent: int) -> None:
    """End this process once its parent has changed."""
    while os.getppid() == parent:
        time.sleep(_POLL_S)
    os._exit(1)
