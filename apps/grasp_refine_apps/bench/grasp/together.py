"""Work that runs in several processes at the same time, and begins in all of them at once."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.synchronize import Barrier
from typing import Any, TypeVar

from grasp_refine.core.interruption import end_with
from grasp_refine_apps.processes.local import inherited_settings

Result = TypeVar("Result")

MAX_WAIT_S = 600.0
"""Longest time in seconds that a process waits for the others to be ready."""


def run_together(works: Sequence[Callable[[Callable[[], None]], Result]]) -> list[Result]:
    """Run the works, each in a process of its own with one thread, and return their results.

    A `ProcessPoolExecutor` would not do: it starts processes while it already waits for others, and misses the end of
    one that it does not know yet (CPython 3.11).

    Args:
        works: Each is called with a function that returns once all works have called it; must be picklable.

    Raises:
        Exception: raised by a work, or RuntimeError where its process ended; the others are ended too.
    """
    # A forked child of a process that has used torch may hang.
    context = multiprocessing.get_context("spawn")
    barrier = context.Barrier(len(works))
    processes, number, results = [], dict[Any, int](), dict[int, Result]()
    try:
        for work in works:
            receiver, sender = context.Pipe(duplex=False)
            number[receiver] = len(number)
            process = context.Process(target=_do, args=(work, barrier, sender, os.getpid()))
            with inherited_settings():
                process.start()
            processes.append(process)
            sender.close()
        while len(results) < len(works):
            for heard in wait([receiver for receiver in number if number[receiver] not in results]):
                results[number[heard]] = _received(heard)
    finally:
        for process in processes:
            process.kill()
            process.join()
        for receiver in number:
            receiver.close()
    return [results[index] for index in range(len(works))]


def _received(receiver: Any) -> Any:
    """Return the result that a process has sent.

    Raises:
        Exception: raised by its work, or RuntimeError where the process ended without a word.
    """
    try:
        succeeded, found = receiver.recv()
    except EOFError:
        raise RuntimeError("a process was terminated before its work was done") from None
    if not succeeded:
        raise found
    return found


def _do(work: Callable[[Callable[[], None]], Result], barrier: Barrier, sender: Connection, parent: int) -> None:
    """Do the work, and send its result, or the error."""
    end_with(parent)

    def ready() -> None:
        barrier.wait(MAX_WAIT_S)

    try:
        sender.send((True, work(ready)))
    except Exception as error:
        sender.send((False, error))
