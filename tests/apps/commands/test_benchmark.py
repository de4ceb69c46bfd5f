"""The frame of all benchmarks: exit codes, and what is written where jobs fail or are interrupted."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from grasp_refine_apps.bench.chart import Row
from grasp_refine_apps.bench.jobs import Job
from grasp_refine_apps.bench.report import Report
from grasp_refine_apps.commands.benchmark import Outputs, run_benchmark
from worker_tasks import fake_job

pytestmark = pytest.mark.usefixtures("workplace")


@dataclass(frozen=True)
class Command:
    """A benchmark without options of its own."""

    preset: str | None = None
    outputs: Outputs = field(default_factory=lambda: Outputs(json=Path("found.json")))


@dataclass(frozen=True)
class Labels:
    """A study whose jobs give their names."""

    labels: tuple[str, ...]
    workers: int = 1

    def jobs(self, say: Callable[[str], None]) -> Sequence[Job]:
        return [fake_job(label) for label in self.labels]

    def rows(self, done: Sequence[Any]) -> list[Row]:
        return [{"label": label} for label in done]

    def report(self, rows: Sequence[Row], problems: Sequence[str]) -> Report:
        return Report(f"{len(rows)} done, {len(problems)} failed", [])


@pytest.mark.parametrize(
    ("labels", "code", "done", "problems"),
    [
        (("a", "b"), 0, 2, ()),
        (("a", "bad", "b"), 1, 2, ("bad: ",)),
        (("a", "stop", "b"), 130, 1, ("interrupted: 1 of 3",)),
        (("a", "bad", "stop"), 130, 1, ("bad: ", "interrupted: 1 of 3")),
    ],
)
def test_what_failed_and_what_was_interrupted_is_reported_by_the_exit_code(
    labels: tuple[str, ...], code: int, done: int, problems: tuple[str, ...]
):
    assert run_benchmark("bench labels", Command(), Labels(labels)) == code
    found = json.loads(Path("found.json").read_text())
    assert [row["label"] for row in found["rows"]] == list(labels[:1]) + ["b"] * (done - 1)
    assert len(found["problems"]) == len(problems)
    assert all(map(str.startswith, found["problems"], problems))


@pytest.mark.parametrize(("labels", "code"), [(("bad",), 1), (("stop", "a"), 130)])
def test_without_results_nothing_is_written(labels: tuple[str, ...], code: int):
    assert run_benchmark("bench labels", Command(), Labels(labels)) == code
    assert not Path("found.json").exists()
