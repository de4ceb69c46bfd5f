"""Arrays in `.npz` files without pickle: read with a named error for every defect, written atomically.

The sizes in an archive's headers are checked before anything is unpacked, so that a small file cannot fill the memory.
"""

from __future__ import annotations

import io
import struct
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from grasp_refine.core.arguments import check_kind, describe_value
from grasp_refine.core.atomic_files import written_whole
from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.lfs_pointer import refuse_lfs_pointer
from grasp_refine.core.names import are_valid, is_file

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

DAMAGED = (OSError, EOFError, MemoryError, NotImplementedError, RuntimeError)
"""Errors that a damaged archive raises, besides zipfile's own: an absurd array size is MemoryError, an unknown
compression NotImplementedError, an encrypted entry RuntimeError."""

ZIP_ERRORS = (*DAMAGED, zipfile.BadZipFile, zlib.error, struct.error, ValueError, LookupError)
"""Errors that zipfile raises on a damaged archive: of a name of a wrong encoding, or of a record that is cut off."""

MAX_UNPACKED_BYTES = 2**31
"""Most bytes of all arrays of a file together: 2 GiB, or eight million grasps of 32 numbers."""
MEMORY_ALLOWANCE_BYTES = 2**26
"""Bytes that the arrays read may take as float64, however small the file: 64 MiB."""
MAX_MEMORY_RATIO = 16
"""Most bytes beyond that, as a multiple of the file's size. Tightly packed float32 poses take 3 times, poses with long
object names and empty targets 10 times; zeros are packed to a thousandth."""
MAGIC = b"\x93NUMPY"
"""First bytes of an array file."""
HEADER_ERRORS = (ValueError, SyntaxError, TypeError, RecursionError, MemoryError, tokenize.TokenError)
"""Errors that a damaged header raises; a deeply nested one is a RecursionError or MemoryError of Python's parser."""
MAX_HEADER_BYTES = 2**16
"""Bytes that are unpacked to read the shape of an array."""


@dataclass(frozen=True, eq=False)
class NpzFile:
    """The entries of one file; its accessors raise GraspFileError in one line that starts with the path."""

    path: Path
    """Path of the file."""
    entries: Mapping[str, np.ndarray]
    """Arrays of the file by name."""

    def error(self, message: str) -> GraspFileError:
        """Return the error with `message` about this file."""
        return GraspFileError(f"{self.path}: {message}")

    def text(self, key: str) -> np.ndarray:
        """Return the entry as an array of strings, of its own shape."""
        value = self.entries[key]
        # An empty list of names is stored by NumPy as float64.
        if value.dtype.kind != "U" and value.size:
            raise self.error(f"{key} must hold text; it holds {value.dtype}")
        value = value.astype(str, copy=False)
        if not are_valid(value):
            raise self.error(f"{key} holds invalid characters, or characters that control a terminal")
        return value

    def name(self, key: str) -> str:
        """Return the entry as one string."""
        value = self.text(key)
        if value.size != 1:
            raise self.error(f"{key} must be one name; it has shape {value.shape}")
        return str(value.item())

    def names(self, key: str) -> tuple[str, ...]:
        """Return the entry as a list of strings."""
        value = self.text(key)
        if value.ndim != 1:
            raise self.error(f"{key} must be a list of names; it has shape {value.shape}")
        return tuple(value.tolist())

    def numbers(self, key: str, *, allowed: Literal["finite", "nan", "any"] = "finite") -> np.ndarray:
        """Return the entry as float64, of its own shape; with "nan" allowed, NaN may mean "none"."""
        value = self.entries[key]
        if value.dtype.kind not in "fiu":
            raise self.error(f"{key} must hold numbers; it holds {value.dtype}")
        value = value.astype(float, copy=False)
        bad = np.isinf(value) if allowed == "nan" else ~np.isfinite(value)
        if allowed != "any" and bad.any():
            row = int(np.argwhere(bad)[0][0]) if value.ndim else 0
            raise self.error(f"{key} must be finite; row {row} is not")
        return value

    def per_row(self, key: str, value: np.ndarray, n: int) -> np.ndarray:
        """Return `value` of the entry `key` as (n,); a single value is repeated."""
        if value.size == 1:
            _check_memory(self.path, n * value.itemsize, f"{key}, once for each of {n} grasps,")
            return np.repeat(value.reshape(1), n)
        if value.shape != (n,):
            raise self.error(f"{key} must be one value or one per grasp, ({n},); it has {value.shape}")
        return value


def load_npz(path: str | Path, *, only: Collection[str] | None = None) -> NpzFile:
    """Return the arrays of an `.npz` file, or `only` the named arrays that it has; none is unpickled.

    Raises GraspFileError when the file is missing, not an `.npz`, damaged, or holds a pickle or anything else but plain
    arrays, or would unpack to more than `MAX_UNPACKED_BYTES` or to other sizes than its headers state, or take more
    than `MEMORY_ALLOWANCE_BYTES` and `MAX_MEMORY_RATIO` times its size as float64.
    """
    path = Path(path)
    if not is_file(path):
        raise GraspFileError(f"{path}: no such grasp file")
    refuse_lfs_pointer(path, "grasp file", GraspFileError)
    entries = {}
    key = ""
    try:
        # NumPy leaves a file open that it opened itself and could not read.
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about headers from Python 2, or damaged ones
            if not zipfile.is_zipfile(file):
                raise GraspFileError(f"{path}: not an .npz grasp file")
            _check_sizes(path, only)
            with np.load(file, allow_pickle=False) as npz:
                for key in npz.files:
                    if only is None or key in only:
                        entries[key] = npz[key]
    except ValueError as error:
        if "allow_pickle" not in str(error):
            raise GraspFileError(f"{path}: entry '{key}' is damaged") from error
        raise GraspFileError(
            f"{path}: entry '{key}' is a pickled object array, which is never loaded; store plain arrays"
        ) from error
    except ZIP_ERRORS as error:
        raise GraspFileError(f"{path}: not a readable .npz file ({error})") from error
    foreign = [key for key, value in entries.items() if not isinstance(value, np.ndarray)]
    if foreign:
        raise GraspFileError(f"{path}: not an .npz grasp file, it holds {', '.join(foreign)}")
    return NpzFile(path, entries)


def is_zip(path: Path) -> bool:
    """Return whether a file has the end of a zip; false for one that cannot be opened, is damaged or missing."""
    try:
        return is_file(path) and zipfile.is_zipfile(path)
    except ZIP_ERRORS:
        return False


def _check_sizes(path: Path, only: Collection[str] | None) -> None:
    """Refuse an archive that would unpack to too many bytes, or whose entries are smaller than their shapes need.

    Numbers count as float64, to which they are converted.
    """
    with zipfile.ZipFile(path) as archive:
        total = sum(entry.file_size for entry in archive.infolist())
        if total > MAX_UNPACKED_BYTES:
            raise GraspFileError(
                f"{path}: would unpack to {total / 2**20:.0f} MiB, as an archive bomb does; at most "
                f"{MAX_UNPACKED_BYTES // 2**20} MiB are read"
            )
        memory_bytes = 0
        for entry in archive.infolist():
            with archive.open(entry) as stream:
                head = stream.read(MAX_HEADER_BYTES)
            if not head.startswith(MAGIC):
                continue
            key = entry.filename.removesuffix(".npy")
            try:
                shape, dtype, start = array_header(head)
            except ValueError:
                raise GraspFileError(f"{path}: entry '{key}' is damaged") from None
            needed = prod(shape) * dtype.itemsize + start
            if not dtype.hasobject and needed > entry.file_size:
                raise GraspFileError(
                    f"{path}: entry '{key}' is damaged: shape {shape} of {dtype} needs {needed} bytes, it has "
                    f"{entry.file_size}"
                )
            if only is None or key in only:
                memory_bytes += prod(shape) * max(dtype.itemsize, 8 if dtype.kind in "fiu" else 1)
    _check_memory(path, memory_bytes, "as float64 it")


def _check_memory(path: Path, memory_bytes: int, what: str) -> None:
    """Refuse `memory_bytes` where they are out of all proportion to the file."""
    size = path.stat().st_size
    if memory_bytes > max(MEMORY_ALLOWANCE_BYTES, MAX_MEMORY_RATIO * size):
        raise GraspFileError(
            f"{path}: {what} would take {memory_bytes / 2**20:.0f} MiB of memory, "
            f"{memory_bytes / max(size, 1):.0f} times the size of the file; above "
            f"{MEMORY_ALLOWANCE_BYTES // 2**20} MiB at most {MAX_MEMORY_RATIO} times is read: split it, or save it "
            "without compression"
        )


def array_header(data: bytes) -> tuple[tuple[int, ...], np.dtype, int]:
    """Shape, type and offset of the data, from the first bytes of an array file; allocates nothing.

    Raises:
        ValueError: the header is damaged.
    """
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about headers from Python 2, or damaged ones
            shape, _, dtype = read(stream)
    except HEADER_ERRORS as error:
        raise ValueError(" ".join(str(error).split())[:80]) from None
    if min(shape, default=0) < 0:
        raise ValueError(f"its shape is {shape}")
    return shape, dtype, stream.tell()


def save_npz(path: str | Path, arrays: Mapping[str, ArrayLike]) -> None:
    """Write `arrays` atomically as an `.npz` without pickle.

    Missing folders are made. Raises GraspFileError when the file cannot be written, or an array could only be stored as
    a pickle.
    """
    check_kind("path", path, str | Path)
    if not isinstance(arrays, Mapping) or not all(isinstance(key, str) for key in arrays):
        raise GraspFileError(f"arrays must be by name, as in GraspSet.arrays(), got {describe_value(arrays)}")
    entries: dict[str, Any] = {}
    for key, value in arrays.items():
        try:
            entries[key] = np.asarray(value.detach().cpu() if hasattr(value, "detach") else value)
        except (TypeError, ValueError):
            entries[key] = np.asarray(None)
        if entries[key].dtype.hasobject:
            raise GraspFileError(f"{path}: '{key}' cannot be stored without pickle: it is no array of one type")
    with written_whole(path, GraspFileError) as partial, partial.open("wb") as stream:
        np.savez(stream, **entries)
