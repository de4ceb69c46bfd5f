"""Contents of a file that `torch.save` wrote: a zip of a pickle and of the bytes of its tensors, read without torch.

`pickled` reads the pickle; here are only stand-ins for what makes tensors, so that nothing of torch is called. Tensors
become NumPy arrays. Files of torch before 1.6, which are no zips, are refused.
"""

from __future__ import annotations

import io
import pickle
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from math import prod
from typing import Any, ClassVar

import numpy as np

from grasp_refine.core.npz_files import ZIP_ERRORS
from grasp_refine.grasps.formats.pickled import (
    FREE_BYTES,
    MAX_BYTES,
    MAX_GROWTH,
    MAX_READS,
    Array,
    Budget,
    Refused,
    Unpickler,
    damaged_as_refused,
    plain,
)

MAX_MEMBERS = 2**20
"""Most files in the zip; each tensor is one."""
PICKLE = "/data.pkl"
"""End of the name of the pickle in the zip."""
STORAGES = {
    "torch.DoubleStorage": "f8",
    "torch.FloatStorage": "f4",
    "torch.HalfStorage": "f2",
    "torch.LongStorage": "i8",
    "torch.IntStorage": "i4",
    "torch.ShortStorage": "i2",
    "torch.CharStorage": "i1",
    "torch.ByteStorage": "u1",
    "torch.BoolStorage": "b1",
}
"""Kinds of tensors that are read -> their NumPy type."""


@dataclass(frozen=True, eq=False)
class _Kind:
    """Kind of the numbers of a tensor."""

    dtype: np.dtype


@dataclass(frozen=True, eq=False)
class _Storage:
    """Numbers of one or several tensors."""

    values: np.ndarray


class _TorchUnpickler(Unpickler):
    """An unpickler that knows tensors, whose numbers are in files of a zip."""

    def __init__(self, data: bytes, budget: Budget, storage: Callable[[str], bytes], order: str) -> None:
        super().__init__(data, budget)
        self.storage, self.order = storage, order
        self.loaded: dict[str, np.ndarray] = {}

    def find_class(self, module: str, name: str) -> Any:
        """Return the stand-in for what a pickle names."""
        full = f"{module}.{name}"
        if full in STORAGES:
            return _Kind(np.dtype(self.order + STORAGES[full]))
        if full in ("torch._utils._rebuild_tensor_v2", "torch._utils._rebuild_tensor"):
            return self.tensor
        if full == "torch._utils._rebuild_parameter":
            return lambda data, *_: data
        return super().find_class(module, name)

    def tensor(self, storage: Any, offset: Any, shape: Any, strides: Any, *_: Any) -> Array:
        """Return the array of a tensor: the numbers of a storage from `offset` on, with strides as numbers of them."""
        lengths = [offset, *shape, *strides]
        if not isinstance(storage, _Storage) or not all(type(length) is int and length >= 0 for length in lengths):
            raise ValueError("a tensor")
        values = storage.values
        last = offset + sum((length - 1) * stride for length, stride in zip(shape, strides, strict=True))
        if prod(shape) and last >= len(values):
            raise Refused(f"a tensor of shape {tuple(shape)} in it is damaged: its numbers are not all there")
        self.budget.size -= prod(shape) * values.itemsize
        self.budget.spend(None)
        if not prod(shape):
            return Array(np.zeros(tuple(shape), values.dtype))
        steps = [stride * values.itemsize for stride in strides]
        return Array(np.lib.stride_tricks.as_strided(values[offset:], tuple(shape), steps).copy())

    def load_binpersid(self) -> None:
        """Put the storage that a pickle names on the stack."""
        named = self.stack.pop()
        if not (isinstance(named, tuple) and len(named) == 5 and named[0] == "storage" and isinstance(named[1], _Kind)):
            raise Refused("holds an object from elsewhere that is no tensor, which is refused")
        _, kind, key, _, count = named
        if not (isinstance(key, str) and type(count) is int and count >= 0):
            raise ValueError("a tensor")
        if key not in self.loaded:
            self.loaded[key] = np.frombuffer(self.storage(key), np.uint8)
        numbers = self.loaded[key]
        if len(numbers) < count * kind.dtype.itemsize:
            raise Refused(f"is damaged: its tensor {key[:20]!r} has {len(numbers)} bytes for {count} numbers")
        self.append(_Storage(numbers[: count * kind.dtype.itemsize].view(kind.dtype)))

    dispatch: ClassVar[dict[int, Callable[[Any], None]]] = Unpickler.dispatch | {pickle.BINPERSID[0]: load_binpersid}
    """Opcode -> method."""


def is_torch_archive(archive: zipfile.ZipFile) -> bool:
    """Return True for a zip with the pickle that `torch.save` writes."""
    return any(name.endswith(PICKLE) for name in archive.namelist())


def is_torch_file(data: bytes) -> bool:
    """Return True for the bytes of such a zip."""
    if not data.startswith(b"PK\x03\x04"):
        return False
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return is_torch_archive(archive)
    except ZIP_ERRORS:
        return False


def load_torch(data: bytes) -> Any:
    """Return what a file of `torch.save` holds, as `unpickle` does, tensors as arrays.

    Raises:
        Refused: it is damaged, names anything but tensors, or would become much larger than it is.
    """
    size = min(MAX_GROWTH * len(data) + FREE_BYTES, MAX_BYTES)
    budget = Budget(size, MAX_READS)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive, damaged_as_refused():
            names = archive.namelist()
            if len(names) > MAX_MEMBERS:
                raise Refused(f"holds {len(names)} files, more than the {MAX_MEMBERS} that are read")
            root = next(name for name in names if name.endswith(PICKLE)).removesuffix(PICKLE)
            big = f"{root}/byteorder" in names and _member(archive, f"{root}/byteorder", budget) == b"big"
            unpickler = _TorchUnpickler(
                _member(archive, f"{root}{PICKLE}", budget),
                budget,
                lambda key: _member(archive, f"{root}/data/{key}", budget),
                ">" if big else "<",
            )
            return plain(unpickler.load(), Budget(size, MAX_READS))
    except ZIP_ERRORS as error:
        raise Refused(f"is a damaged torch file ({' '.join(str(error).split())[:80]})") from None


def _member(archive: zipfile.ZipFile, name: str, budget: Budget) -> bytes:
    """Return the bytes of one file of a zip, which count."""
    try:
        found = archive.getinfo(name)
    except KeyError:
        raise Refused(f"is damaged: it lacks {name[:80]!r}") from None
    if found.compress_type != zipfile.ZIP_STORED:
        raise Refused("is compressed, as torch.save never does")
    budget.size -= found.file_size
    budget.spend(None)
    return archive.read(found)


def dump_torch(content: Any) -> bytes:
    """Return the bytes of a file that `torch.load` reads, arrays as tensors."""
    import torch

    def tensors(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return torch.from_numpy(np.ascontiguousarray(value))
        if isinstance(value, dict):
            return {key: tensors(part) for key, part in value.items()}
        if isinstance(value, list | tuple):
            return type(value)(tensors(part) for part in value)
        return value

    stream = io.BytesIO()
    torch.save(tensors(content), stream)
    return stream.getvalue()
