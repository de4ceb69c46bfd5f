"""Files appear whole or not at all."""

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from grasp_refine.core.atomic_files import half_written, half_written_path, written_whole
from grasp_refine.core.errors import GraspFileError, GraspRefineError
from refusals import refused


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "film.gif"
    path.write_text("before")
    with pytest.raises(ZeroDivisionError), written_whole(path) as partial:
        assert partial.suffix == ".gif"
        partial.write_text("half")
        raise ZeroDivisionError
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]
    with written_whole(tmp_path / "new" / "file.txt") as partial:
        partial.write_text("whole")
    assert [entry.name for entry in (tmp_path / "new").iterdir()] == ["file.txt"]


def test_each_thread_writes_a_partial_file_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "entry.npz"
    with ThreadPoolExecutor(1) as pool, written_whole(path) as own:
        own.write_text("whole")
        other = pool.submit(half_written_path, path).result()
        assert other != own
        assert half_written(own.name) == half_written(other.name) == (os.getpid(), path.name)
    assert path.read_text() == "whole"


def test_what_cannot_be_written_is_an_error_of_the_kind_that_was_asked_for(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with (
        refused(GraspRefineError, "below.gif"),
        written_whole(tmp_path / "file/below.gif"),
    ):
        pass
    with refused(GraspFileError, "below.npz"), written_whole(tmp_path / "file/below.npz", GraspFileError):
        pass


def test_links_and_pipes_are_written_to_not_replaced(tmp_path: Path) -> None:
    target, link, pipe = tmp_path / "target", tmp_path / "link", tmp_path / "pipe"
    link.symlink_to(target)
    with written_whole(link) as path:
        path.write_text("x")
    assert link.is_symlink() and target.read_text() == "x"
    os.mkfifo(pipe)
    with written_whole(pipe) as path:
        assert path == pipe
    assert pipe.is_fifo()
