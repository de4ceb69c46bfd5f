"""Dispatch of tasks, by workers that are only written down: attempts, patience, and when tasks are given."""

from collections.abc import Iterator
from itertools import chain, repeat
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from grasp_refine_apps.processes import dispatch as module
from grasp_refine_apps.processes.dispatch import Lost, dispatch
from grasp_refine_apps.processes.task import Failed, Sign
from refusals import assert_names
from worker_tasks import some_tasks

BEGUN = ("one", Sign("refining", 0.25, 0))
LOST = ("one", Lost("was ended by SIGSEGV", "log"))
PATIENCE_S = 10.0


class WrittenPool:
    """A worker `one`; each listening takes the next seconds and brings the next messages, then nothing for ever."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *steps: tuple[Any, ...], has_queues: bool = False) -> None:
        self.has_queues, self._now_s = has_queues, 0.0
        self._steps: Iterator[tuple[Any, ...]] = chain(steps, repeat((1.0,)))
        self.given: list[int] = []
        self.restarted = 0
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: self._now_s))

    def workers(self, wanted: int) -> list[str]:
        return ["one"][:wanted]

    def submit(self, worker: str, task: Any) -> None:
        self.given.append(task.number)

    def listen(self) -> list[tuple[str, Any]]:
        seconds, *messages = next(self._steps)
        self._now_s += seconds
        return messages

    def restart(self, worker: str) -> str:
        self.restarted += 1
        return "where it hung"


def outcomes(pool: WrittenPool, count: int = 1, tries: int = 2) -> list[Any]:
    found = dispatch(
        some_tasks(Path(), *["x"] * count), pool, tries=tries, patience_s=PATIENCE_S, heartbeat=lambda *_: None
    )
    return [outcome for _, outcome in found]


@pytest.mark.parametrize("tries", [1, 2, 3])
def test_a_task_whose_worker_is_lost_is_tried_again(monkeypatch: pytest.MonkeyPatch, tries: int):
    pool = WrittenPool(monkeypatch, *[(1.0, BEGUN), (1.0, LOST)] * 5)
    (failure,) = outcomes(pool, tries=tries)
    assert isinstance(failure, Failed) and (failure.reason, failure.tries, failure.traceback) == (
        "crashed",
        tries,
        "log",
    )
    assert_names(failure.message, "one", "SIGSEGV", "25%", "refining")
    assert pool.given == [0] * tries


def test_an_error_is_no_accident_but_counts_the_crash_before(monkeypatch: pytest.MonkeyPatch):
    error = ("one", Failed("error", "no luck", "Traceback"))
    pool = WrittenPool(monkeypatch, (1.0, LOST), (1.0, ("one", "result")), (1.0, error), (1.0, error))
    result, *failures = outcomes(pool, 3, tries=9)
    assert [(one.reason, one.tries) for one in failures] == [("error", 1), ("error", 2)]
    # The lost one comes after the others of its group.
    assert result == "result" and pool.given == [0, 1, 2, 0]


def test_a_silent_worker_is_restarted(monkeypatch: pytest.MonkeyPatch):
    pool = WrittenPool(monkeypatch, (1.0, BEGUN))
    (failure,) = outcomes(pool)
    assert (failure.reason, failure.tries, failure.traceback) == ("hung", 2, "where it hung")
    assert_names(failure.message, "one", f"{PATIENCE_S:g} s")
    assert (pool.given, pool.restarted) == ([0, 0], 2)


def test_a_task_in_a_queue_may_be_silent_until_it_begins(monkeypatch: pytest.MonkeyPatch):
    """What somebody else gave to the worker, and what is left of an interrupted run, comes first."""
    silence = [(1.0,)] * 100
    pool = WrittenPool(monkeypatch, *silence, (1.0, ("one", "result")), has_queues=True)
    assert outcomes(pool) == ["result"]
    pool = WrittenPool(monkeypatch, (1.0, BEGUN), *silence, (1.0, ("one", "result")), has_queues=True)
    assert [outcome.reason for outcome in outcomes(pool, tries=1)] == ["hung"]


def test_a_pause_of_the_caller_or_the_machine_makes_no_worker_look_dead(monkeypatch: pytest.MonkeyPatch):
    """Only time in which somebody listened counts."""
    pool = WrittenPool(monkeypatch, (1.0, BEGUN), (3600.0,), (1.0, ("one", "result")))
    assert outcomes(pool) == ["result"] and pool.restarted == 0


def test_workers_have_tasks_while_the_caller_handles_results(monkeypatch: pytest.MonkeyPatch):
    pool = WrittenPool(monkeypatch, (1.0, ("one", "first")))
    found = dispatch(some_tasks(Path(), "x", "y"), pool, tries=1, patience_s=None, heartbeat=lambda *_: None)
    assert next(found)[1] == "first" and pool.given == [0, 1]
