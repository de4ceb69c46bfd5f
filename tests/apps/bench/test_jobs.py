"""Jobs are run in turn or side by side; neither failures nor interruptions lose what is done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pytest

from grasp_refine_apps.bench import jobs as module
from grasp_refine_apps.bench.jobs import run_jobs


@dataclass(frozen=True)
class Fake:
    """A job that gives its name, or fails."""

    label: str
    work: float = 1.0

    def do(self, progress: Callable[[float], None]) -> str:
        progress(0.5)
        if self.label == "stop":
            raise KeyboardInterrupt
        if self.label == "bad":
            raise ValueError("no luck")
        return self.label


def test_a_failed_job_does_not_end_the_others():
    told: list[tuple[float, str]] = []
    results, problems = run_jobs([Fake("a"), Fake("bad"), Fake("b", 2.0)], 1, lambda *what: told.append(what))
    assert results == ["a", "b"]
    (problem,) = problems
    assert problem.startswith("bad: Traceback") and problem.endswith("ValueError: no luck")
    assert told == [(0.125, "a"), (0.375, "bad"), (0.75, "b")]


def test_an_interruption_keeps_what_is_done():
    results, problems = run_jobs([Fake("a"), Fake("stop"), Fake("b")], 1, lambda *_: None)
    assert (results, problems) == (["a"], ["interrupted: 1 of 3 jobs were done"])


def test_what_comes_back_is_in_the_order_of_the_jobs(monkeypatch: pytest.MonkeyPatch):
    ended = [(2, "c"), (0, "a"), (1, "b")]
    monkeypatch.setattr(module, "_run_parallel", lambda *_: iter(ended))
    assert run_jobs([Fake(name) for name in "abc"], 2, lambda *_: None) == (["a", "b", "c"], [])


def test_an_interrupted_process_gives_no_result(monkeypatch: pytest.MonkeyPatch):
    """It hands back a KeyboardInterrupt, which is no Exception and once came out as if it were a result."""
    monkeypatch.setattr(module, "_run_parallel", lambda *_: iter([(1, KeyboardInterrupt()), (0, "a")]))
    results, problems = run_jobs([Fake("a"), Fake("b")], 2, lambda *_: None)
    assert (results, problems) == (["a"], ["b: KeyboardInterrupt"])
