"""A real Dask cluster on this machine: workers that hang, wait or are not fit, and a scheduler that is lost."""

import os
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dask_cluster import DaskCluster
from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.processes.cluster import ClusterPool, connect
from grasp_refine_apps.processes.cluster_worker import WorkerEnvironment, fault_of
from grasp_refine_apps.processes.dispatch import dispatch
from refusals import assert_names, refused
from running_processes import PATIENCE_S
from worker_tasks import some_tasks, work

HERE = WorkerEnvironment((("grasp-refine", "1.0"), ("Python", "3.11"), ("distributed", "2026.8.0")), True, True)


def ignore(number: int, what: str, share: float, finished: int) -> None:
    pass


def outcomes(address: str, folder: Path, *verbs: str, tries: int = 2, patience_s: float = PATIENCE_S) -> dict[int, Any]:
    """Number -> result or failure."""
    with connect(address) as client:
        pool = ClusterPool(client, address, work, folder)
        found = dispatch(some_tasks(folder, *verbs), pool, tries=tries, patience_s=patience_s, heartbeat=ignore)
        return {task.number: outcome for task, outcome in found}


def test_a_folder_that_workers_do_not_see_is_refused(address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    with refused(GraspRefineError, "tcp://127.0.0.1:", "hidden"):
        outcomes(address, Path("hidden"), "write")
    assert list(Path("hidden").iterdir()) == []


def test_without_anybody_there_the_refusal_says_what_to_start(tmp_path: Path):
    scheduler = tmp_path / "scheduler.json"
    for address, why in (
        ("tcp://127.0.0.1:1", "ConnectionRefusedError"),
        ("nonsense", "ValueError"),
        (str(scheduler), "FileNotFoundError"),
    ):
        with refused(GraspRefineError, address, why, "dask scheduler", "tcp://host:8786"):
            outcomes(address, tmp_path, "write")


@pytest.mark.parametrize(
    ("there", "threads", "named"),
    [
        (HERE, 1, ()),
        (
            ModuleNotFoundError("No module named 'grasp_refine'"),
            1,
            ("grasp-refine", "ModuleNotFoundError: No module named 'grasp_refine'"),
        ),
        (None, 1, ("grasp-refine", "answer")),
        (
            replace(HERE, versions=(("grasp-refine", "2.0"), *HERE.versions[1:])),
            1,
            ("grasp-refine 2.0", "grasp-refine 1.0", "Python 3.11", "distributed 2026.8.0"),
        ),
        (replace(HERE, reads=False), 1, ("/out",)),
        (replace(HERE, writes=False), 1, ("/out", "write")),
        (HERE, 4, ("4 threads", "--nthreads 1")),
    ],
)
def test_what_makes_a_worker_unfit(there: object, threads: int, named: tuple[str, ...]):
    fault = fault_of(there, HERE, threads, Path("/out"))
    assert bool(fault) == bool(named)
    assert_names(fault, *named)


@pytest.fixture
def bare(tmp_path: Path) -> Iterator[DaskCluster]:
    """A cluster without workers."""
    (folder := tmp_path / "cluster").mkdir()
    started = DaskCluster(folder)
    try:
        yield started
    finally:
        started.end()


def test_workers_that_lack_the_package_or_do_not_come_are_named(bare: DaskCluster, tmp_path: Path):
    with refused(GraspRefineError, f"dask worker {bare.address} --nworkers 2 --nthreads 1"):
        outcomes(bare.address, tmp_path, "write")
    (lacking := tmp_path / "lacking").mkdir()
    (lacking / "sitecustomize.py").write_text("import sys; sys.modules['grasp_refine'] = None\n")
    bare.add_workers("--no-nanny", "--nthreads", "1", path=lacking)
    bare.wait_for_workers(1)
    with refused(GraspRefineError, "grasp-refine", "ModuleNotFoundError"):
        outcomes(bare.address, tmp_path, "write")


@pytest.mark.slow
def test_a_worker_that_hangs_for_ever_and_a_scheduler_that_is_lost(bare: DaskCluster, tmp_path: Path):
    """Nobody restarts this worker, so it gets nothing any more; without a scheduler, the batch ends with advice."""
    bare.add_workers("--no-nanny", "--nthreads", "1")
    bare.wait_for_workers(1)
    tasks = some_tasks(tmp_path, "write", "sleep 3600", "write")
    with connect(bare.address) as client:
        pool = ClusterPool(client, bare.address, work, tmp_path)
        results = dispatch(tasks, pool, tries=1, patience_s=10.0, heartbeat=ignore)
        assert next(results) == (tasks[0], "0.txt")
        task, hung = next(results)
        assert task is tasks[1] and hung.reason == "hung"
        os.killpg(bare.scheduler.pid, signal.SIGKILL)
        with refused(GraspRefineError, bare.address, "scheduler"):
            next(results)
    assert not tasks[2].path.exists()
