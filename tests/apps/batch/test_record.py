"""What a batch leaves of its shards: complete only what is whole and of the same inputs."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.core.atomic_files import written_whole
from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.batch.record import (
    State,
    clean,
    forget_failure,
    is_result,
    note_failure,
    noted_failure,
    state_of,
)
from grasp_refine_apps.batch.rows import NEEDED, TEXTS, read_rows
from grasp_refine_apps.batch.shard import Shard
from grasp_refine_apps.processes.task import Failed
from refusals import refused


def shard(folder: Path, stamp: str = "abc") -> Shard:
    return Shard(3, "group", "job: hand, mug, part 0", 4, folder / "job" / "hand_mug_00000.npz", stamp, None)


def written(of: Shard, provenance: object) -> Shard:
    of.path.parent.mkdir(exist_ok=True)
    # Of larger arrays, reading one does not check the others.
    np.savez(of.path, q=np.arange(20_000.0), provenance=np.array(json.dumps(provenance)))
    return of


def test_a_result_is_complete_when_it_is_whole_and_has_the_stamp(tmp_path: Path):
    one = shard(tmp_path)
    assert state_of(one) is State.MISSING
    written(one, {"batch": {"stamp": "abc"}})
    assert state_of(one) is State.COMPLETE
    assert state_of(shard(tmp_path, stamp="other")) is State.CHANGED


@pytest.mark.parametrize("provenance", [{}, {"batch": None}, {"batch": {}}, [], "text", {"batch": ["stamp"]}])
def test_files_of_something_else_are_changed(tmp_path: Path, provenance: object):
    assert state_of(written(shard(tmp_path), provenance)) is State.CHANGED


def test_every_damage_is_seen(tmp_path: Path):
    one = written(shard(tmp_path), {"batch": {"stamp": "abc"}})
    whole = one.path.read_bytes()
    for at in range(100, len(whole) - 200, 9973):
        one.path.write_bytes(whole[:at] + bytes([whole[at] ^ 255]) + whole[at + 1 :])
        assert state_of(one) is State.DAMAGED, at
    for length in (0, 1, 100, len(whole) // 2, len(whole) - 1):
        one.path.write_bytes(whole[:length])
        assert state_of(one) is State.DAMAGED, length
    np.savez(one.path, q=np.zeros(3))
    assert state_of(one) is State.DAMAGED
    np.savez(one.path, provenance=np.array("no JSON"))
    assert state_of(one) is State.DAMAGED


def test_a_failure_is_noted_and_what_was_there_before_goes(tmp_path: Path):
    one = written(shard(tmp_path), {"batch": {"stamp": "old"}})
    failed = Failed("crashed", "the worker ended", "Traceback ...", 2)
    note_failure(one, failed)
    assert not one.path.exists()
    assert noted_failure(one) == failed
    assert noted_failure(shard(tmp_path, stamp="other")) is None
    forget_failure(one)
    assert noted_failure(one) is None
    assert list(one.path.parent.iterdir()) == []
    forget_failure(one)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"stamp": "abc"}', "3"])
def test_a_damaged_note_is_none(tmp_path: Path, text: str):
    one = shard(tmp_path)
    one.path.parent.mkdir()
    one.path.with_name(one.path.name + ".failed.json").write_text(text)
    assert noted_failure(one) is None


def test_a_note_that_cannot_be_written_is_reported(tmp_path: Path):
    (tmp_path / "job").write_text("in the way")
    with refused(GraspRefineError, tmp_path / "job"):
        note_failure(shard(tmp_path), Failed("error", "x", "", 1))


def test_what_killed_processes_left_is_taken_away_and_what_others_write_is_not(tmp_path: Path):
    one = shard(tmp_path)
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    with written_whole(one.path) as partial:
        partial.touch()
        mine = partial.name
        left, other, elsewhere = (
            partial.with_name(name)
            for name in (
                mine.replace(str(os.getpid()), str(ended.pid), 1),
                mine.replace(str(os.getpid()), str(ended.pid), 1).replace("00000", "00001"),
                f".{ended.pid}.partial.another0.{one.path.name}",
            )
        )
        for path in (left, other, elsewhere):
            path.touch()
        clean([one.path])
        assert not left.exists()
        assert partial.exists()
        assert other.exists()
        assert elsewhere.exists()


def test_a_result_is_known_from_other_files(tmp_path: Path):
    assert is_result(written(shard(tmp_path), {"batch": {"stamp": "abc"}}).path)
    assert not is_result(written(shard(tmp_path), {}).path)
    (tmp_path / "grasps.npz").write_text("none")
    assert not is_result(tmp_path / "grasps.npz")
    assert not is_result(tmp_path / "grasps.npy")
    assert not is_result(tmp_path)


def test_what_is_too_deep_or_no_array_is_no_result_of_a_batch(tmp_path: Path):
    """Python's reader of JSON recurses, and NumPy parses the head of an array as Python."""
    one = shard(tmp_path)
    one.path.parent.mkdir()
    np.savez(one.path, provenance=np.array("[" * 10**5))
    assert not is_result(one.path) and state_of(one) is State.DAMAGED
    with zipfile.ZipFile(one.path, "w") as archive:
        archive.writestr("provenance.npy", b"\x93NUMPY\x01\x00\x08\x00((((((((")
    assert not is_result(one.path) and state_of(one) is State.DAMAGED
    one.path.write_bytes(b"PK\x05\x06")
    assert not is_result(one.path)
    one.path.with_name(one.path.name + ".failed.json").write_text("[" * 10**5)
    assert noted_failure(one) is None


@pytest.mark.parametrize(
    "provenance",
    [
        {"source": ["x"]},
        {"row": 3},
        {"row": ["x"]},
        {"row": [[1], 2]},
        {"batch": {"look": 3}},
        {"batch": {"job": "\x1b[2J"}},
        {"source": {"path": "a\nb"}},
    ],
)
def test_a_record_that_no_batch_has_written_is_damaged(tmp_path: Path, provenance: dict):
    one = shard(tmp_path)
    one.path.parent.mkdir()
    texts = dict.fromkeys(TEXTS, np.array(["x"])) | {"provenance": np.array(json.dumps(provenance))}
    np.savez(one.path, **(dict.fromkeys(NEEDED, np.zeros(1)) | texts))
    with refused(GraspRefineError, one.path, "provenance"):
        read_rows(one, tmp_path)
