"""Array files and pickles: read plain, bounded, and refused in one line that begins with the path."""

import io
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.formats import content
from grasp_refine.grasps.formats.content import load_content
from refusals import refused


class Call:
    """Makes a folder when it is unpickled."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.folder),)


def npy(value: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, value)
    return stream.getvalue()


def crafted(header: str, data: bytes = b"") -> bytes:
    """An array file with this header."""
    text = header.encode("latin-1") + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data


def check_refused(path: Path, *named: str) -> None:
    with refused(GraspFileError, path, *named):
        load_content(path)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "grasp.npy"


def test_arrays_and_pickles_are_read(file: Path):
    for value in (np.arange(6.0, dtype=np.float32).reshape(2, 3), np.asfortranarray(np.ones((2, 3)))):
        file.write_bytes(npy(value))
        np.testing.assert_array_equal(load_content(file), value)
        assert load_content(file).dtype == value.dtype
    grasp = {"grasp_qpos": np.arange(3.0), "obj_path": "a/b"}
    for data in (npy(grasp), pickle.dumps(grasp)):
        file.write_bytes(data)
        read = load_content(file)
        assert read["obj_path"] == "a/b"
        np.testing.assert_array_equal(read["grasp_qpos"], np.arange(3.0))
    file.write_bytes(npy([grasp, grasp]))
    assert [entry["obj_path"] for entry in load_content(file)] == ["a/b", "a/b"]


def test_code_in_an_array_file_is_refused_and_does_not_run(file: Path):
    folder = file.parent / "made"
    for value in ({"grasp_qpos": Call(folder)}, [1, Call(folder)], Call(folder)):
        for data in (npy(np.array(value, dtype=object)), pickle.dumps(value)):
            file.write_bytes(data)
            check_refused(file, "posix.mkdir", "numbers", "text", "lists", "dicts", "NumPy arrays")
    assert not folder.exists()


@pytest.mark.parametrize(
    ("data", "named"),
    [
        (b"", ("empty",)),
        (b"# text", ("damaged", "pickle")),
        (b"\x93NUMPY", ("damaged .npy", "header")),
        (b"\x93NUMPY\x07\x00\x10\x00", ("damaged .npy", "header")),
        (crafted("{'descr': '<f8', 'fortran_order': False, 'shape': (3,)"), ("damaged .npy", "header")),
        (crafted("[" * 5000), ("damaged .npy", "header")),
        (crafted("{'descr': '<f8', 'fortran_order': False, 'shape': (-3,)}"), ("damaged .npy", "header")),
        (
            crafted("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 1000)}", b"12345678"),
            ("(1000000000000, 1000)", "float64", "8000000000000000 bytes", "8 "),
        ),
        (
            crafted("{'descr': '<f8', 'fortran_order': False, 'shape': (0, 1" + "0" * 30 + ")}"),
            ("damaged .npy",),
        ),
        (crafted("{'descr': '<c16', 'fortran_order': False, 'shape': (0,)}"), ("complex128",)),
        (crafted("{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (0,)}"), ("('a', '<f8')",)),
        (npy(np.arange(4.0))[:-1], ("(4,)", "float64", "32 bytes", "31")),
        (npy({"a": 1})[:-5], ("pickle",)),
        (npy({"a": 1.0})[:-5], ("pickle",)),
    ],
)
def test_damaged_files(file: Path, data: bytes, named: tuple[str, ...]):
    file.write_bytes(data)
    check_refused(file, *named)


def test_files_that_are_not_there_or_too_large(file: Path, monkeypatch: pytest.MonkeyPatch):
    check_refused(file)
    check_refused(file.parent, "directory")
    monkeypatch.setattr(content, "MAX_FILE_BYTES", 2**20)
    with file.open("wb") as stream:
        stream.truncate(2**20 + 1)
    check_refused(file, "1 MiB")
