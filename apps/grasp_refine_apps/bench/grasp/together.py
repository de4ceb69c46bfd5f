"""Work that runs in several processes at the same time, and begins in all of them at once."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from multiprocessing.synchronize import Barrier
from threading import BrokenBarrierError
from typing import Any, TypeVar

from grasp_refine.core.interruption import end_with

Result = TypeVar("Result")

MAX_WAIT_S = 600.0
"""Longest time in seconds that a process waits for the others to be ready."""


def run_together(works: Sequence[Callable[[Callable[[], None]], Result]]) -> list[Result]:
    """Run the works, each in a process of its own, and return their results.

    Args:
        works: Each is called with a function that returns once all works have called it; must be picklable.

    Raises:
        Exception: raised by a work, or RuntimeError where its process ended; the others are ended too.
    """
    # A forked child of a process that has used torch may hang.
    context = multiprocessing.get_context("spawn")
    barrier = context.Barrier(len(works))
    children: dict[Connection, SpawnProcess] = {}
    found: dict[Any, Any] = {}
    try:
        for work in works:
            told, its = context.Pipe(duplex=False)
            child = context.Process(target=_do, args=(work, barrier, its, os.getpid()))
            child.start()
            its.close()
            children[told] = child
        while len(found) < len(children):
            # In order of arrival: the others may be waiting for one that ended.
            waiting = [mine for mine in children if mine not in found]
            ready = wait(waiting)
            for mine in (mine for mine in waiting if mine in ready):
                found[mine] = _received(children[mine], mine)
                # A broken barrier is a consequence of another error.
                if isinstance(found[mine], Exception) and not isinstance(found[mine], BrokenBarrierError):
                    raise found[mine]
        for one in found.values():
            if isinstance(one, Exception):
                raise one
        return [found[mine] for mine in children]
    finally:
        for mine, child in children.items():
            child.terminate()
            child.join()
            mine.close()


def _received(child: Any, mine: Connection) -> Any:
    try:
        return mine.recv()
    except EOFError:
        child.join()
        return RuntimeError(f"a process ended without a result, exit code {child.exitcode}")


def _do(work: Callable[[Callable[[], None]], Any], barrier: Barrier, told: Connection, parent: int) -> None:
    """Run the child's part, with one thread: the other cores are for the others."""
    end_with(parent)
    os.environ["OMP_NUM_THREADS"] = "1"

    def ready() -> None:
        barrier.wait(MAX_WAIT_S)

    try:
        result = work(ready)
    except Exception as error:
        barrier.abort()
        result = error
    with suppress(BrokenPipeError):
        told.send(result)
