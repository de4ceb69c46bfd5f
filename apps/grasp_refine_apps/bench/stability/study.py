"""A run of the benchmark: each task asks all it has to ask, and rows come out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from grasp_refine_apps.bench.jobs import run_jobs
from grasp_refine_apps.bench.stability.counts import wrong
from grasp_refine_apps.bench.stability.derivative import derivative_cells
from grasp_refine_apps.bench.stability.forward import forward_cells
from grasp_refine_apps.bench.stability.labels import length
from grasp_refine_apps.bench.stability.rows import Cell
from grasp_refine_apps.bench.stability.task import Task


@dataclass(frozen=True)
class Outcome:
    """What came out of a study."""

    rows: list[dict[str, Any]]
    """The cells."""
    problems: list[str]
    """What went wrong with tasks that ended early: each is an exception that should not have been."""

    @property
    def wrong(self) -> bool:
        """Whether something is."""
        return bool(self.problems) or any(map(wrong, self.rows))


@dataclass(frozen=True)
class TaskJob:
    """A task that goes to one process."""

    task: Task

    @property
    def work(self) -> float:
        """About how long it takes: many pieces take longest."""
        return 4.0 if self.task.kind == "concave40" else 1.0

    @property
    def label(self) -> str:
        """What it is, for a progress bar."""
        return f"{self.task.kind}, {length(self.task.diagonal)}"

    def do(self, progress: Callable[[float], None]) -> list[Cell]:
        """What came of all its cells."""
        found: list[Cell] = []
        both = (forward_cells, self.task.forwards), (derivative_cells, self.task.derivatives)
        asked = [cells for cells, ways in both if ways]
        states = self.task.states
        for part, cells in enumerate(asked):
            for cell in cells(self.task):
                found.append(cell)
                progress((part + (1 + states.index(cell.state)) / len(states)) / len(asked))
        return found


def run_study(tasks: Sequence[Task], workers: int, progress: Callable[[float, str], None]) -> Outcome:
    """Do all tasks.

    Args:
        tasks: What is asked.
        workers: Processes.
        progress: Gets the share of the work that is done, and what is.
    """
    done, problems = run_jobs([TaskJob(task) for task in tasks], workers, progress)
    return Outcome([cell.row() for its in done for cell in its], problems)
