"""A real Dask cluster on this machine: shards come out as without it, also when workers die, hang or are not fit."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from distributed import Client

from dask_cluster import DaskCluster
from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.batch.cluster import run_on_cluster
from grasp_refine_apps.batch.cluster_workers import fault_of
from grasp_refine_apps.batch.on_cluster import WorkerEnvironment
from grasp_refine_apps.batch.shard import Done, Failed
from refusals import assert_names, refused
from running_processes import PATIENCE_S, soon
from shard_works import Tally, done, some_shards, tallies, work

HERE = WorkerEnvironment((("grasp-refine", "1.0"), ("Python", "3.11"), ("distributed", "2026.8.0")), True, True)


def ignore(number: int, what: str, share: float, refined: int) -> None:
    pass


def workers_of(cluster: DaskCluster, count: int, seconds: float = PATIENCE_S) -> None:
    """Wait for so many workers."""
    with Client(cluster.address, set_as_default=False) as client:
        client.wait_for_workers(count, timeout=seconds)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    """Two workers, each restarted when it dies."""
    started = DaskCluster(tmp_path_factory.mktemp("cluster"))
    try:
        started.add_workers("--nworkers", "2", "--nthreads", "1")
        yield started
    finally:
        started.end()


@pytest.fixture
def address(cluster: DaskCluster) -> str:
    """Of a cluster whose two workers are there."""
    workers_of(cluster, 2)
    return cluster.address


def outcomes(
    address: str,
    folder: Path,
    *tasks: str,
    tries: int = 2,
    patience_s: float = PATIENCE_S,
    heartbeat: Callable = ignore,
) -> dict[int, Done | Failed]:
    """Number -> what came of it."""
    shards = some_shards(folder, *tasks)
    results = run_on_cluster(shards, work, address=address, tries=tries, patience_s=patience_s, heartbeat=heartbeat)
    return {each.number: each for each in results}


def test_every_shard_comes_out_and_what_work_raises_is_told(address: str, tmp_path: Path):
    told: list[tuple[int, str, float, int]] = []
    tasks = ["a:write", "a:raise mesh", "b:raise stubborn", "b:beat 1.5", "a:write", "b:write"]
    found = outcomes(address, tmp_path, *tasks, heartbeat=lambda *what: told.append(what))
    failures = {number: found.pop(number) for number in (1, 2)}
    shards = some_shards(tmp_path, *tasks)
    assert found == {shard.number: done(shard) for shard in shards if shard.number not in failures}
    assert [(each.reason, each.message, each.tries) for each in failures.values()] == [
        ("error", "mug.obj: no such mesh; try another", 1),
        ("error", "StubbornError: its message cannot be printed", 1),
    ]
    assert "in _raise" in failures[1].traceback
    assert len({(tmp_path / f"{number}.txt").read_text() for number in found}) == 2
    assert (0, "write", 0.25, 0) in told and (3, "still there", 0.5, 3) in told
    assert not list(tmp_path.glob(".probe*"))


def test_work_keeps_what_it_has_loaded(address: str, tmp_path: Path):
    """Each shard once came with a copy of the work that had loaded nothing."""
    shards = some_shards(tmp_path, *["write"] * 6)
    (scheduler := tmp_path / "scheduler.json").write_text(json.dumps({"address": address}))
    assert len(list(run_on_cluster(shards, Tally(), address=str(scheduler), heartbeat=ignore))) == 6
    assert len(calls := tallies(tmp_path)) <= 2
    assert all(each == list(range(1, len(each) + 1)) for each in calls)


def test_shards_of_lost_workers_are_tried_again(address: str, tmp_path: Path):
    """One worker is killed in the middle of a shard, one kills itself whenever it gets a certain shard."""
    tasks = ["a:crash once SIGKILL", "b:crash SIGKILL", *["c:write"] * 6]
    found = outcomes(address, tmp_path, *tasks)
    lost = found.pop(1)
    assert found == {shard.number: done(shard) for shard in some_shards(tmp_path, *tasks) if shard.number != 1}
    assert (lost.reason, lost.tries) == ("crashed", 2)
    # If it had time for a sign of life, that is told as well.
    assert_names(lost.message, "tcp://127.0.0.1:")


@pytest.mark.slow
def test_a_worker_that_hangs_is_restarted(address: str, tmp_path: Path):
    found = outcomes(address, tmp_path, "a:sleep 3600", "b:beat 15", "b:write", tries=1, patience_s=10.0)
    hung = found.pop(0)
    assert found == {shard.number: done(shard) for shard in some_shards(tmp_path, "", "", "")[1:]}
    assert (hung.reason, hung.tries) == ("hung", 1)
    assert_names(hung.message, "10 s", "25%", "sleep 3600")


def test_a_shard_that_waits_for_others_is_not_taken_for_one_that_hangs(address: str, tmp_path: Path):
    """What somebody else gave to the workers, and what is left of an interrupted batch, comes first."""
    with Client(address, set_as_default=False) as other:
        busy = [other.submit(time.sleep, 12.0, workers=[worker], pure=False) for worker in other.nthreads()]
        assert soon(lambda: all(other.processing().values()))
        assert outcomes(address, tmp_path, "write", tries=1, patience_s=8.0) == {0: done(some_shards(tmp_path, "")[0])}
        assert any(future.done() for future in busy)


def test_a_caller_who_stops_lets_no_other_shard_begin(address: str, tmp_path: Path):
    """But those that workers have by then: one each."""
    results = run_on_cluster(some_shards(tmp_path, *["beat 0.3"] * 8), work, address=address, heartbeat=ignore)
    next(results)
    results.close()
    time.sleep(1.5)
    begun = len(list(tmp_path.glob("*.started")))
    assert begun <= 4 and soon(lambda: len(list(tmp_path.glob("*.txt"))) == begun)
    assert len(list(tmp_path.glob("*.started"))) == begun


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


def test_no_shards_need_no_cluster(tmp_path: Path):
    assert outcomes("nonsense", tmp_path) == {}


def test_without_dask_the_refusal_says_how_to_install_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delitem(sys.modules, "grasp_refine_apps.batch.cluster_client", raising=False)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with refused(GraspRefineError, "distributed", "pip install 'grasp-refine[cluster]'"):
        outcomes("tcp://127.0.0.1:1", tmp_path, "write")


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
    workers_of(bare, 1)
    with refused(GraspRefineError, "grasp-refine", "ModuleNotFoundError"):
        outcomes(bare.address, tmp_path, "write")


@pytest.mark.slow
def test_a_worker_that_hangs_for_ever_and_a_scheduler_that_is_lost(bare: DaskCluster, tmp_path: Path):
    """Nobody restarts this worker, so it gets nothing any more; without a scheduler, the batch ends with advice."""
    bare.add_workers("--no-nanny", "--nthreads", "1")
    workers_of(bare, 1)
    shards = some_shards(tmp_path, "write", "sleep 3600", "write")
    results = run_on_cluster(shards, work, address=bare.address, tries=1, patience_s=10.0, heartbeat=ignore)
    assert next(results) == done(shards[0])
    hung = next(results)
    assert isinstance(hung, Failed) and (hung.number, hung.reason) == (1, "hung")
    os.killpg(bare.scheduler.pid, signal.SIGKILL)
    with refused(GraspRefineError, bare.address, "scheduler"):
        next(results)
    assert not shards[2].path.exists()
