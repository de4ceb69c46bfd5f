"""One attempt at a task: heartbeats at most so often, and failures that say why and can be sent."""

import pickle
from pathlib import Path
from types import SimpleNamespace

import pytest

from grasp_refine.core.errors import ConventionError
from grasp_refine_apps.processes import task as module
from grasp_refine_apps.processes.task import Failed, Heartbeat, attempt
from refusals import assert_names
from worker_tasks import some_tasks, work


def test_what_work_raises_is_a_failure_in_its_own_words(tmp_path: Path) -> None:
    kinds = ("mesh", "value", "stubborn", "memory", "full", "long")
    tasks = some_tasks(tmp_path, *(f"raise {kind}" for kind in kinds))
    failures = [pickle.loads(pickle.dumps(attempt(work, task, lambda sign: None, 0.0))) for task in tasks]
    assert [each.reason for each in failures] == ["disk full" if kind == "full" else "error" for kind in kinds]
    assert_names(failures[2].message, "StubbornError")
    assert [each.message for each in failures[:5] if each is not failures[2]] == [
        "mug.obj: no such mesh; try another",
        "ValueError: no luck",
        "MemoryError",
        "OSError: [Errno 28] No space left on device: 'out.npz'",
    ]
    assert failures[5].message == f"ValueError: {'x' * 488} ..."
    assert all(each.traceback.startswith("Traceback") and "in _raise" in each.traceback for each in failures[:5])
    assert Failed.of(ConventionError("turned")).reason == "suspected"
    unsendable = attempt(lambda task, heartbeat: lambda: None, tasks[0], lambda sign: None, 0.0)
    assert isinstance(unsendable, Failed)


def test_heartbeats_are_sent_at_most_so_often(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, sent = 100.0, []
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now_s))

    def beating(task: object, heartbeat: Heartbeat) -> str:
        nonlocal now_s
        for k in range(10):
            heartbeat("still", k / 10, k)
            now_s += 0.25
        return "done"

    (task,) = some_tasks(Path(), "x")
    assert attempt(beating, task, sent.append, 0.5) == "done"
    assert [tuple(sign) for sign in sent] == [("still", k / 10, k) for k in range(0, 10, 2)]
