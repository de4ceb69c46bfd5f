"""Paths that can be written are told from others before the work starts."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import check_writable, dumps, save_json
from refusals import refused


def test_a_full_disk_is_reported_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a" / "report.json"
    save_json(path, {"x": 1})

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with refused(GraspRefineError, path, "No space left on device"):
        save_json(path, {"x": 2})
    assert list(path.parent.iterdir()) == [path] and '"x": 1' in path.read_text()


def test_numbers_that_are_not_finite_are_null():
    document = {
        "single": float("nan"), "several": [np.inf, np.float32(-np.inf), np.int64(3)],
        "array": np.array([[np.nan, 2.5], [-np.inf, 0.0]]), "path": Path("a.npz"), 7: (None, True),
    }  # fmt: skip
    assert json.loads(dumps(document)) == {
        "single": None, "several": [None, None, 3],
        "array": [[None, 2.5], [None, 0.0]], "path": "a.npz", "7": [None, True],
    }  # fmt: skip


def test_unwritable_places_are_found_out_before_the_work(tmp_path: Path):
    file, deep = tmp_path / "file", tmp_path / "new" / "folder" / "file.json"
    check_writable(file, None, overwrite=False)
    for inside in (tmp_path / "new", tmp_path / "new" / "folder"):
        check_writable(file, deep, overwrite=False, inside=inside)
    assert list(tmp_path.iterdir()) == []
    with refused(GraspRefineError, deep.parent):
        check_writable(deep, overwrite=True, inside=tmp_path / "other")
    with refused(GraspRefineError, tmp_path):
        check_writable(tmp_path, overwrite=True)
    file.write_text("")
    with refused(GraspRefineError, file / "other"):
        check_writable(file / "other", overwrite=True)
    with refused(GraspRefineError, "file:"):
        check_writable(file, tmp_path / "new" / ".." / "file", overwrite=True, inside=tmp_path)


def test_files_that_exist_are_kept_unless_asked(tmp_path: Path):
    file, link, pipe = tmp_path / "file", tmp_path / "link", tmp_path / "pipe"
    file.write_text("kept")
    link.symlink_to(file)
    os.mkfifo(pipe)
    for path in (file, link):
        with refused(GraspRefineError, path, "`overwrite`"):
            check_writable(path, overwrite=False)
        check_writable(path, overwrite=True)
    for device in (pipe, Path("/dev/stdout"), Path("/dev/null")):
        check_writable(device, overwrite=False)
    check_writable(Path("/dev/null"), Path("/dev/null"), overwrite=False)
