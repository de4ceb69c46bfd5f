"""Jobs of a benchmark, run in this process or in several; an interruption keeps the results so far."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from grasp_refine_apps.processes.dispatch import dispatch
from grasp_refine_apps.processes.local import LocalPool
from grasp_refine_apps.processes.task import LOST, Failed, Heartbeat

Progress = Callable[[float], None]
"""Called with the share of a job that is done."""


def part_of(progress: Progress, before: float, size: float) -> Progress:
    """Return the progress of a part of a job, which begins at the share `before` and is the share `size` of it."""
    return lambda share: progress(before + size * share)


@dataclass(frozen=True)
class Job:
    """A piece of work for one process."""

    label: str
    """Label for a progress bar."""
    run: Callable[[Progress], Any]
    """Does the work and returns its result; picklable, where there are several processes."""
    work: float = 1.0
    """Approximate duration, in arbitrary units."""


def run_jobs(
    todo: Sequence[Job], workers: int, progress: Callable[[float, str], None]
) -> tuple[list[Any], list[str], bool]:
    """Run the jobs; return their results, in order, the errors of failed jobs, and whether the run was interrupted.

    A failing job does not end the others; an interruption ends the remaining jobs and keeps the finished results.

    Args:
        todo: Jobs.
        workers: Processes; with 1, all jobs run in this one.
        progress: Called with the share of the work that is done, and the label of the job.
    """
    results: dict[int, Any] = {}
    problems: list[str] = []
    interrupted = False
    try:
        for index, outcome in _run_serially(todo, progress) if workers == 1 else _run_parallel(todo, workers, progress):
            if isinstance(outcome, Failed):
                error = outcome.traceback if outcome.reason not in LOST else outcome.message
                problems.append(f"{todo[index].label}: {error}")
            else:
                results[index] = outcome
    except KeyboardInterrupt:
        interrupted = True
    return [results[index] for index in sorted(results)], problems, interrupted


def _run_serially(todo: Sequence[Job], progress: Callable[[float, str], None]) -> Iterator[tuple[int, Any]]:
    """Run each job in this process and yield its index with its result or failure."""
    total, finished = sum(job.work for job in todo), 0.0
    for index, job in enumerate(todo):

        def within(share: float, before: float = finished, job: Job = job) -> None:
            progress((before + share * job.work) / total, job.label)

        try:
            yield index, job.run(within)
        except Exception as error:
            yield index, Failed.of(error)
        finished += job.work


@dataclass(frozen=True)
class _Task:
    """A job as a task of a worker; each is a group of its own."""

    number: int
    group: str
    job: Job


def _run_parallel(
    todo: Sequence[Job], workers: int, progress: Callable[[float, str], None]
) -> Iterator[tuple[int, Any]]:
    """Run the jobs in several processes and yield each index with its result or failure, as they end."""
    total, finished = sum(job.work for job in todo), 0.0
    # The longest first, so that no process is left with a long job at the end.
    order = sorted(range(len(todo)), key=lambda index: -todo[index].work)
    tasks = [_Task(index, str(index), todo[index]) for index in order]
    with closing(LocalPool(_do, workers)) as pool:
        for task, outcome in dispatch(tasks, pool, tries=1, patience_s=None, heartbeat=lambda *_: None):
            yield task.number, outcome
            finished += task.job.work
            progress(finished / total, task.job.label)


def _do(task: _Task, heartbeat: Heartbeat) -> Any:
    """Run a job without progress."""
    return task.job.run(lambda share: None)
