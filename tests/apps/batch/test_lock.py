"""Lock of a results folder: one batch at a time, or disjoint parts of one; locks of killed processes do not count."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from batch_rows import shard
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.machine import host
from grasp_refine_apps.batch.lock import PREFIX, STALE_S, locked
from refusals import refused

SHARDS = (shard(0, Path("a.npz")), shard(1, Path("b.npz")))


def locks(out: Path) -> list[Path]:
    return sorted(out.glob(f"{PREFIX}*"))


def left_by(out: Path, host: str, pid: int, *, age_s: float = 0.0, part: tuple[int, int] = (1, 1)) -> Path:
    """The lock of another process with other settings, touched some seconds ago."""
    path, now = out / f"{PREFIX}{host}.{pid}.json", time.time()
    path.write_text(json.dumps({"host": host, "pid": pid, "since": now - 3600.0, "plan": "other", "part": part}))
    os.utime(path, (now - age_s, now - age_s))
    return path


def ended_process() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_a_folder_is_locked_while_a_batch_works_there(tmp_path: Path):
    with locked(tmp_path / "out", SHARDS, (1, 1)):
        assert len(locks(tmp_path / "out")) == 1
    assert locks(tmp_path / "out") == []
    with pytest.raises(KeyError), locked(tmp_path, SHARDS, (1, 1)):
        raise KeyError
    assert locks(tmp_path) == []


@pytest.mark.parametrize(
    ("host", "pid", "part"), [(host(), 1, (1, 1)), ("elsewhere", 2**22, (1, 1)), (host(), 1, (2, 1))]
)
def test_another_batch_is_refused_and_named(tmp_path: Path, host: str, pid: int, part: tuple[int, int]):
    there = left_by(tmp_path, host, pid, part=part)
    with refused(GraspRefineError, tmp_path, host, pid, there, "--out"), locked(tmp_path, SHARDS, (1, 1)):
        pass
    assert locks(tmp_path) == [there], "the lock of the other one stays, ours goes"


@pytest.mark.parametrize(("host", "age_s"), [(host(), 0.0), ("elsewhere", 2 * STALE_S), (host(), 2 * STALE_S)])
def test_locks_of_killed_processes_do_not_count(tmp_path: Path, host: str, age_s: float):
    left_by(tmp_path, host, ended_process() if not age_s else 1, age_s=age_s)
    with locked(tmp_path, SHARDS, (1, 1)):
        assert len(locks(tmp_path)) == 1


@pytest.mark.parametrize(
    ("part", "apart"), [((1, 2), False), ((2, 2), True), ((2, 3), False)], ids=["same part", "other part", "other cut"]
)
def test_other_parts_of_the_same_batch_may_run_at_once(tmp_path: Path, part: tuple[int, int], apart: bool):
    with locked(tmp_path, SHARDS, (1, 2)):
        (ours,) = locks(tmp_path)
        theirs = json.loads(ours.read_text()) | {"pid": 1, "since": time.time() - 60.0, "part": part}
        ours.rename(tmp_path / f"{PREFIX}{host()}.1.json").write_text(json.dumps(theirs))
        if apart:
            with locked(tmp_path, SHARDS, (1, 2)):
                pass
        else:
            with refused(GraspRefineError, "process 1"), locked(tmp_path, SHARDS, (1, 2)):
                pass


def test_of_two_that_start_at_once_the_first_one_stays(tmp_path: Path):
    later = left_by(tmp_path, host(), 1)
    later.write_text(later.read_text().replace(str(json.loads(later.read_text())["since"]), str(time.time() + 60.0)))
    with locked(tmp_path, SHARDS, (1, 1)):
        assert len(locks(tmp_path)) == 2
