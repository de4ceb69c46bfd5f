"""Work in several processes at the same time, with a common start."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from grasp_refine_apps.processes.dispatch import dispatch
from grasp_refine_apps.processes.local import LocalPool
from grasp_refine_apps.processes.task import Failed, Heartbeat

Result = TypeVar("Result")

POLL_INTERVAL_S = 1e-3
"""Interval between two looks at whether the other processes are ready, seconds."""


@dataclass(frozen=True)
class _Task:
    """A work as a task of a worker; each is a group of its own, so that all are begun."""

    number: int
    group: str
    work: Callable[[Callable[[], None]], Any]


def run_together(works: Sequence[Callable[[Callable[[], None]], Result]]) -> list[Result]:
    """Run the works, each in a process of its own with one thread, and return their results.

    Args:
        works: Each is called with a function that returns once all works have called it; must be picklable.

    Raises:
        RuntimeError: a work raised, or its process ended; the others are ended too.
    """
    tasks = [_Task(number, str(number), work) for number, work in enumerate(works)]
    results: dict[int, Result] = {}
    with TemporaryDirectory() as folder, closing(LocalPool(partial(_do, Path(folder), len(works)), len(works))) as pool:
        for task, outcome in dispatch(tasks, pool, tries=1, patience_s=None, heartbeat=lambda *_: None):
            if isinstance(outcome, Failed):
                raise RuntimeError(outcome.message)
            results[task.number] = outcome
    return [results[number] for number in range(len(works))]


def _do(folder: Path, count: int, task: _Task, heartbeat: Heartbeat) -> Any:
    """Run the work of a process. Each of the `count` processes leaves a file in the folder when it is ready."""

    def ready() -> None:
        (folder / str(task.number)).touch()
        while len(list(folder.iterdir())) < count:
            time.sleep(POLL_INTERVAL_S)

    return task.work(ready)
