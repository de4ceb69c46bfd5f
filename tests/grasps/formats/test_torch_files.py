"""Files of torch.save: tensors become arrays, nothing runs, and what is damaged or far too large is refused."""

import io
import os
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from grasp_refine.core.errors import GraspFileError
from grasp_refine.grasps.formats import torch_files
from grasp_refine.grasps.formats.content import load_content
from grasp_refine.grasps.formats.torch_files import dump_torch
from refusals import refused


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "a.pt"


def test_tensors_of_every_kind_and_layout(file: Path):
    whole = torch.arange(24.0).reshape(4, 6)
    held = {
        "rows": [whole[1], whole[:, 2], whole.T, whole[1:3, ::2], whole[0, 0], torch.zeros(0, 3)],
        "expanded": torch.ones(3, 1).expand(3, 5),
        "parameter": torch.nn.Parameter(torch.ones(2)),
        **{
            str(kind): torch.tensor([0, 1, 2]).to(kind)
            for kind in (torch.float64, torch.float16, torch.int64, torch.int32, torch.int16, torch.uint8, torch.bool)
        },
        "text": ("a", 1, None, True),
    }
    torch.save(held, file)
    read = load_content(file)
    assert read["text"] == ("a", 1, None, True)
    for key, value in held.items():
        for one, other in zip(
            value if isinstance(value, list) else [value],
            read[key] if isinstance(read[key], list) else [read[key]],
            strict=True,
        ):
            if isinstance(one, torch.Tensor):
                np.testing.assert_array_equal(one.detach().numpy(), other)
                assert other.dtype == one.detach().numpy().dtype


def test_what_is_written_is_what_torch_reads(file: Path):
    content = {"a": np.arange(6.0).reshape(2, 3).T, "b": [(np.float32([1, 2]), "x")], "c": np.array([True])}
    file.write_bytes(dump_torch(content))
    held = torch.load(file, weights_only=True)
    np.testing.assert_array_equal(held["a"].numpy(), content["a"])
    assert held["b"][0][1] == "x" and held["b"][0][0].dtype == torch.float32
    np.testing.assert_array_equal(load_content(file)["a"], content["a"])


class Call:
    """Makes a folder when it is unpickled."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.folder),)


def test_code_is_refused_and_does_not_run(file: Path):
    folder = file.parent / "made"
    torch.save({"a": torch.ones(2), "b": Call(folder)}, file)
    with refused(GraspFileError, file, "posix.mkdir", "refused"):
        load_content(file)
    assert not folder.exists()
    torch.save(torch.nn.Linear(2, 2), file)
    with refused(GraspFileError, file, "torch.nn.modules.linear.Linear"):
        load_content(file)


def archive(file: Path, pickled: bytes, compression: int = zipfile.ZIP_STORED, **members: bytes) -> Path:
    with zipfile.ZipFile(file, "w", compression) as made:
        made.writestr("a/data.pkl", pickled)
        for name, data in members.items():
            made.writestr(f"a/data/{name.removeprefix('n')}", data)
    return file


def tensor(offset: int, shape: tuple[int, ...], strides: tuple[int, ...], count: int = 4, key: str = "0") -> bytes:
    """A pickle of one tensor."""

    class Storage:
        pass

    class Tensor:
        def __reduce__(self) -> Any:
            return torch._utils._rebuild_tensor_v2, (Storage(), offset, shape, strides, False, {})

    class Pickler(pickle.Pickler):
        def persistent_id(self, value: Any) -> Any:
            return ("storage", torch.FloatStorage, key, "cpu", count) if isinstance(value, Storage) else None

    stream = io.BytesIO()
    Pickler(stream, 2).dump(Tensor())
    return stream.getvalue()


@pytest.mark.parametrize(
    ("pickled", "named"),
    [
        (tensor(0, (5,), (1,)), ("(5,)",)),
        (tensor(2, (3,), (1,)), ("(3,)",)),
        (tensor(0, (2, 2), (3, 1)), ("(2, 2)",)),
        (tensor(0, (2,), (-1,)), ("damaged",)),
        (tensor(-1, (2,), (1,)), ("damaged",)),
        (tensor(0, (4,), (1,), count=5), ("16 bytes", "5")),
        (tensor(0, (4,), (1,), key="7"), ("lacks", "a/data/7")),
        (tensor(0, (4,), (1,), key="../data.pkl"), ("lacks",)),
        (tensor(0, (2**40,), (0,)), ("bomb",)),
        (tensor(0, (2**20, 2**20), (0, 0)), ("bomb",)),
        (b"", ("cut off",)),
        (pickle.dumps(torch.FloatStorage), ("function or a type",)),
        (pickle.dumps(torch.BFloat16Storage), ("torch.BFloat16Storage",)),
    ],
)
def test_tensors_that_are_not_there(pickled: bytes, named: tuple[str, ...], file: Path):
    archive(file, pickled, n0=bytes(16))
    with refused(GraspFileError, file, *named):
        load_content(file)


def test_zips_that_are_none_of_torch(file: Path, monkeypatch: pytest.MonkeyPatch):
    archive(file, tensor(0, (4,), (1,)), zipfile.ZIP_DEFLATED, n0=bytes(16))
    with refused(GraspFileError, file, "compressed"):
        load_content(file)
    whole = archive(file, tensor(0, (4,), (1,)), n0=bytes(16)).read_bytes()
    for end in (len(whole) // 2, len(whole) - 5):
        file.write_bytes(whole[:end])
        with refused(GraspFileError, file):
            load_content(file)
    file.write_bytes(whole)
    monkeypatch.setattr(torch_files, "MAX_MEMBERS", 1)
    with refused(GraspFileError, file, "2 files", "1 that"):
        load_content(file)
    torch.save({"a": torch.ones(2)}, file, _use_new_zipfile_serialization=False)
    with refused(GraspFileError, file):
        load_content(file)
