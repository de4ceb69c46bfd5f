"""A run of the benchmark: each task makes all its queries, and returns rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from grasp_refine_apps.bench.jobs import Job, run_jobs
from grasp_refine_apps.bench.stability.counts import wrong
from grasp_refine_apps.bench.stability.derivative import derivative_cells
from grasp_refine_apps.bench.stability.forward import forward_cells
from grasp_refine_apps.bench.stability.labels import length
from grasp_refine_apps.bench.stability.rows import Cell
from grasp_refine_apps.bench.stability.task import Task


@dataclass(frozen=True)
class Outcome:
    """Results of a study."""

    rows: list[dict[str, Any]]
    """Entries of the tables, one for each cell."""
    problems: list[str]
    """Errors of tasks that ended early: each is an exception that should not occur."""

    @property
    def wrong(self) -> bool:
        """Whether any task or cell has a fault."""
        return bool(self.problems) or any(map(wrong, self.rows))


@dataclass(frozen=True)
class TaskJob:
    """A task that goes to one process."""

    task: Task

    @property
    def work(self) -> float:
        """Approximate duration: many pieces take longest."""
        return 4.0 if self.task.kind == "concave40" else 1.0

    @property
    def label(self) -> str:
        """Label of the job, for a progress bar."""
        return f"{self.task.kind}, {length(self.task.diagonal)}"

    def do(self, progress: Callable[[float], None]) -> list[Cell]:
        """Check all its cells."""
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
    """Run all tasks.

    Args:
        tasks: Tasks to run.
        workers: Processes.
        progress: Called with the share of the work that is done, and its label.
    """
    done, problems = run_jobs([Job(one.label, one.do, one.work) for one in map(TaskJob, tasks)], workers, progress)
    return Outcome([cell.row() for its in done for cell in its], problems)
