"""Jobs of a benchmark, run in this process or in several; an interruption keeps the results so far."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from traceback import format_exception
from typing import Any, Protocol, runtime_checkable

from grasp_refine.core.interruption import end_with


@runtime_checkable
class Job(Protocol):
    """A piece of work for one process."""

    @property
    def work(self) -> float:
        """Approximate duration, in arbitrary units."""
        ...

    @property
    def label(self) -> str:
        """Label of the job, for a progress bar."""
        ...

    def do(self, progress: Callable[[float], None]) -> Any:
        """Run the job in this process; `progress` is called with the share that is done."""
        ...


def run_jobs(todo: Sequence[Job], workers: int, progress: Callable[[float, str], None]) -> tuple[list[Any], list[str]]:
    """Run the jobs; return their results, in order, and the errors of those without a result.

    A failing job does not end the others; an interruption ends those that are left and keeps the finished results.

    Args:
        todo: Jobs.
        workers: Processes; with 1, all jobs run in this one.
        progress: Called with the share of the work that is done, and its label.
    """
    results: dict[int, Any] = {}
    problems: list[str] = []
    try:
        for index, outcome in _run_serially(todo, progress) if workers == 1 else _run_parallel(todo, workers, progress):
            # An interrupted process returns a KeyboardInterrupt, which is not a result.
            if isinstance(outcome, BaseException):
                problems.append(f"{todo[index].label}: {''.join(format_exception(outcome)).strip()}")
            else:
                results[index] = outcome
    except KeyboardInterrupt:
        problems.append(f"interrupted: {len(results)} of {len(todo)} jobs were done")
    return [results[index] for index in sorted(results)], problems


def _run_serially(todo: Sequence[Job], progress: Callable[[float, str], None]) -> Iterator[tuple[int, Any]]:
    """Run each job in this process and yield its index with its result or error."""
    total, finished = sum(job.work for job in todo), 0.0
    for index, job in enumerate(todo):

        def within(share: float, before: float = finished, job: Job = job) -> None:
            progress((before + share * job.work) / total, job.label)

        try:
            yield index, job.do(within)
        except Exception as error:
            yield index, error
        finished += job.work


def _run_parallel(
    todo: Sequence[Job], workers: int, progress: Callable[[float, str], None]
) -> Iterator[tuple[int, Any]]:
    """Run the jobs in several processes and yield each index with its result or error, as they end."""
    total, finished = sum(job.work for job in todo), 0.0
    # A forked child of a process that has used torch may hang.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        min(workers, len(todo)), mp_context=context, initializer=end_with, initargs=(os.getpid(),)
    ) as pool:
        try:
            # The longest first, so that no process is left with a long job at the end.
            order = sorted(range(len(todo)), key=lambda index: -todo[index].work)
            futures = {pool.submit(_do, todo[index]): index for index in order}
            for future in as_completed(futures):
                index = futures[future]
                error = future.exception()
                yield index, future.result() if error is None else error
                finished += todo[index].work
                progress(finished / total, todo[index].label)
        except BaseException:
            for process in pool._processes.values():
                process.terminate()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _do(job: Job) -> Any:
    """Run a job without progress."""
    return job.do(lambda share: None)
