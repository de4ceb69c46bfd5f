"""Work that runs in several processes at the same time, and begins in all of them at once."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
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
    pool = ProcessPoolExecutor(len(works), mp_context=context, initializer=_begin, initargs=(os.getpid(),))
    with context.Manager() as manager, pool:
        barrier = manager.Barrier(len(works))
        # A work waits for all others, so that no process gets two.
        futures = [pool.submit(_do, work, barrier) for work in works]
        errors = [error for one in futures if (error := one.exception()) is not None]
        # A broken barrier is a consequence of another error.
        for error in sorted(errors, key=lambda error: isinstance(error, BrokenBarrierError)):
            raise error
        return [one.result() for one in futures]


def _begin(parent: int) -> None:
    """Prepare a process, with one thread: the other cores are for the others."""
    end_with(parent)
    os.environ["OMP_NUM_THREADS"] = "1"


def _do(work: Callable[[Callable[[], None]], Result], barrier: Any) -> Result:
    def ready() -> None:
        barrier.wait(MAX_WAIT_S)

    try:
        return work(ready)
    except Exception:
        barrier.abort()
        raise
