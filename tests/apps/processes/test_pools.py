"""Real workers of this machine and of a Dask cluster: tasks come out alike, also when workers die or hang."""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from grasp_refine_apps.processes.cluster import ClusterPool, connect
from grasp_refine_apps.processes.dispatch import Pool, dispatch
from grasp_refine_apps.processes.local import LocalPool
from refusals import assert_names
from running_processes import PATIENCE_S
from worker_tasks import Tally, some_tasks, work

Start = Callable[..., AbstractContextManager[Pool]]


@pytest.fixture(params=["local", "cluster"])
def start(request: pytest.FixtureRequest, tmp_path: Path) -> Start:
    """Starts two workers on a work function; a context."""
    if request.param == "local":
        return lambda work=work: closing(LocalPool(work, 2))
    address = request.getfixturevalue("address")

    @contextmanager
    def pool(work: Callable = work) -> Iterator[Pool]:
        with connect(address) as client:
            yield ClusterPool(client, address, work, tmp_path)

    return pool


def outcomes(start: Start, folder: Path, *verbs: str, told: list | None = None, **limits: Any) -> dict[int, Any]:
    """Number -> result or failure."""
    limits = {"tries": 2, "patience_s": PATIENCE_S} | limits
    told = [] if told is None else told
    with start() as pool:
        given = dispatch(some_tasks(folder, *verbs), pool, **limits, heartbeat=lambda *sign: told.append(sign))
        return {task.number: outcome for task, outcome in given}


def test_every_task_comes_out_and_what_work_raises_is_kept(start: Start, tmp_path: Path):
    told: list[tuple[int, str, float, int]] = []
    verbs = ["a:write", "a:raise mesh", "b:raise stubborn", "b:beat 1.5", "a:write", "b:write"]
    found = outcomes(start, tmp_path, *verbs, told=told)
    failures = [found.pop(number) for number in (1, 2)]
    assert found == {number: f"{number}.txt" for number in (0, 3, 4, 5)}
    assert [(one.reason, one.message, one.tries) for one in failures] == [
        ("error", "mug.obj: no such mesh; try another", 1),
        ("error", "StubbornError: its message cannot be printed", 1),
    ]
    assert "in _raise" in failures[0].traceback
    assert len({(tmp_path / name).read_text() for name in found.values()}) == 2
    assert (0, "write", 0.25, 0) in told and (3, "still there", 0.5, 3) in told
    assert not list(tmp_path.glob(".probe*"))


def test_work_keeps_what_it_has_loaded(start: Start, tmp_path: Path):
    """Each task once came with a copy of the work that had loaded nothing."""
    calls: dict[int, list[int]] = {}
    with start(Tally()) as pool:
        for _, (process, count) in dispatch(
            some_tasks(tmp_path, *["write"] * 6), pool, tries=1, patience_s=None, heartbeat=lambda *_: None
        ):
            calls.setdefault(process, []).append(count)
    assert sum(map(len, calls.values())) == 6 and len(calls) <= 2
    assert all(counts == list(range(1, len(counts) + 1)) for counts in calls.values())


@pytest.mark.slow
def test_tasks_of_lost_workers_are_tried_again(start: Start, tmp_path: Path):
    """One worker is killed in the middle of a task, one kills itself whenever it gets a certain task."""
    found = outcomes(start, tmp_path, "a:crash once SIGKILL", "b:crash SIGKILL", *["c:write"] * 6)
    lost = found.pop(1)
    assert found == {number: f"{number}.txt" for number in (0, *range(2, 8))}
    assert (lost.reason, lost.tries) == ("crashed", 2)
    assert_names(lost.message, "worker ")


def test_a_caller_who_stops_lets_no_other_task_begin(start: Start, tmp_path: Path):
    with start() as pool:
        verbs = ["a:write", *["a:beat 0.5"] * 8]
        next(dispatch(some_tasks(tmp_path, *verbs), pool, tries=1, patience_s=None, heartbeat=lambda *_: None))
    time.sleep(1.5)
    # Those that workers had by then: one each, of which a cluster may have been given another.
    assert len(list(tmp_path.glob("*.started"))) <= 4
