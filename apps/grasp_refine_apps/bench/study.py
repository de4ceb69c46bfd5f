"""Study of a benchmark: jobs that measure, flat rows of their results, and a report of the rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol, runtime_checkable

from grasp_refine_apps.bench.chart import Row
from grasp_refine_apps.bench.jobs import Job
from grasp_refine_apps.bench.report import Report


@runtime_checkable
class Study(Protocol):
    """A benchmark with all its settings."""

    @property
    def workers(self) -> int:
        """Number of processes; with 1, all jobs run in this one."""
        ...

    def jobs(self, say: Callable[[str], None]) -> Sequence[Job]:
        """Load the inputs, report progress in lines for people, and return the jobs.

        Raises:
            GraspRefineError: the inputs cannot be used.
        """
        ...

    def rows(self, done: Sequence[Any]) -> list[Row]:
        """Return flat rows of the results of the jobs, in SI units unless the key says otherwise."""
        ...

    def report(self, rows: Sequence[Row], problems: Sequence[str]) -> Report:
        """Return tables, charts and notes of the rows; `problems` are the errors of jobs without a result."""
        ...
