"""Contents of an HDF5 file: groups as dicts, datasets as arrays or text, of bounded number and size; needs h5py.

The HDF5 library runs for ever on some damaged files. So it reads in a process of its own:
`python -m grasp_refine.grasps.formats.hdf5_files < FILE`.
"""

from __future__ import annotations

import io
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from math import prod
from typing import Any

import numpy as np

from grasp_refine.grasps.formats.pickled import MAX_DEPTH, Refused
from grasp_refine.grasps.formats.reading_apart import answer, read_apart

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
"""First bytes of an HDF5 file."""
MAX_OBJECTS = 10_000
"""Most groups and datasets."""
MAX_DATA_BYTES = 2**28
"""Largest size of all datasets, and of a chunk, in bytes; compressed ones may be far smaller in the file."""
MAX_TEXTS = 10_000
"""Most texts in a dataset."""
INSTALL = "it takes h5py to read and write it: pip install 'grasp-refine[hdf5]'"


@dataclass
class _Budget:
    """Number of objects and bytes that may still be read."""

    objects: int = MAX_OBJECTS
    size: int = MAX_DATA_BYTES


def load_hdf5(data: bytes) -> dict[str, Any]:
    """Return the groups and datasets of a file; links to other files, and data in them, are refused.

    Raises:
        Refused: it is damaged, too large, refers to other files, or h5py is missing.
    """
    if find_spec("h5py") is None:
        raise Refused(f"is an HDF5 file, and {INSTALL}")
    name = "grasp_refine.grasps.formats.hdf5_files"
    return read_apart(name, damaged="is a damaged HDF5 file", data=data)


def parse_hdf5(data: bytes) -> dict[str, Any]:
    """Return the groups and datasets of a file, read in this process, which a damaged one may keep for ever.

    Raises:
        Refused: it is damaged, too large, or refers to other files.
    """
    import h5py

    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            return _group(h5py, file, _Budget(), 0)
    except (OSError, RuntimeError, ValueError, KeyError, TypeError, OverflowError, MemoryError) as error:
        raise Refused(f"is a damaged HDF5 file ({' '.join(str(error).split())[:100]})") from None


def _group(h5py: Any, group: Any, budget: _Budget, depth: int) -> dict[str, Any]:
    if depth > MAX_DEPTH:
        raise Refused(f"holds groups nested more than {MAX_DEPTH} deep")
    found: dict[str, Any] = {}
    for name in group:
        budget.objects -= 1
        if budget.objects < 0:
            raise Refused(f"holds more than the {MAX_OBJECTS} groups and datasets that are read")
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise Refused(f"refers to something elsewhere under {name[:40]!r}, which is not read")
        part = group[name]
        if isinstance(part, h5py.Group):
            found[name] = _group(h5py, part, budget, depth + 1)
        elif isinstance(part, h5py.Dataset):
            found[name] = _dataset(h5py, part, name[:40], budget)
    return found


def _dataset(h5py: Any, dataset: Any, name: str, budget: _Budget) -> Any:
    if dataset.external or dataset.is_virtual:
        raise Refused(f"has the data of {name!r} in another file, which is not read")
    if dataset.shape is None:
        return None
    size = max(prod(dataset.shape), prod(dataset.chunks or ())) * dataset.dtype.itemsize
    budget.size -= size
    if budget.size < 0:
        raise Refused(f"holds more than the {MAX_DATA_BYTES / 2**20:.0f} MiB that are read, in {name!r} at the latest")
    if h5py.check_string_dtype(dataset.dtype) is not None:
        if prod(dataset.shape) > MAX_TEXTS:
            raise Refused(f"holds {prod(dataset.shape)} texts in {name!r}; {MAX_TEXTS} are read")
        texts = dataset.asstr(errors="replace")[()]
        return texts if isinstance(texts, str) else np.asarray(texts, dtype=object).ravel().tolist()
    if dataset.dtype.kind not in "biuf":
        raise Refused(f"holds data of the type {dataset.dtype} in {name!r}; numbers and text are read")
    return np.asarray(dataset[()])


def dump_hdf5(content: dict[str, Any]) -> bytes:
    """Return the bytes of a file with dicts as groups.

    Raises:
        Refused: h5py is missing.
    """
    try:
        import h5py
    except ImportError:
        raise Refused(f"{INSTALL[0].upper()}{INSTALL[1:]}") from None

    def put(group: Any, parts: dict[str, Any]) -> None:
        for name, part in parts.items():
            if isinstance(part, dict):
                put(group.create_group(name), part)
            elif isinstance(part, np.ndarray) and part.ndim:
                group.create_dataset(name, data=part, compression="gzip")
            else:
                group[name] = part

    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        put(file, content)
    return stream.getvalue()


if __name__ == "__main__":
    sys.exit(answer(lambda: parse_hdf5(sys.stdin.buffer.read())))
