"""Contents of a file of another program, whatever holds them: read without running anything, of bounded size."""

from __future__ import annotations

import io
import warnings
import zipfile
from math import prod
from pathlib import Path
from typing import IO, Any

import numpy as np

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.lfs_pointer import refuse_lfs_pointer
from grasp_refine.core.names import is_file
from grasp_refine.core.npz_files import MAGIC, MAX_HEADER_BYTES, ZIP_ERRORS, array_header
from grasp_refine.grasps.formats.archives import ARCHIVE_SUFFIXES
from grasp_refine.grasps.formats.hdf5_files import HDF5_MAGIC, load_hdf5
from grasp_refine.grasps.formats.pickled import (
    ARRAY_KINDS,
    FREE_BYTES,
    MAX_GROWTH,
    Damaged,
    Refused,
    check_text,
    unpickle,
)
from grasp_refine.grasps.formats.texts import (
    TOML_SUFFIX,
    YAML_SUFFIXES,
    is_json,
    is_yaml,
    load_json,
    load_toml,
    load_yaml,
)
from grasp_refine.grasps.formats.torch_files import is_torch_file, load_torch

ARRAY_SUFFIXES = (".npz", ".npy", ".pickle", ".pkl")
"""Endings of files that can hardly be anything but grasps in a folder of such."""
OTHER_SUFFIXES = (".yaml", ".yml", ".json", ".pt", ".pth", ".h5", ".hdf5", ".toml", *ARCHIVE_SUFFIXES)
"""Endings of files that may be grasps, or what lies beside them."""
SUFFIXES = (*ARRAY_SUFFIXES, *OTHER_SUFFIXES)
"""Endings of grasp files."""
TABLE_SUFFIXES = (".csv", ".parquet")
"""Endings of tables, which another file describes."""

CONTROLS = frozenset(map(chr, range(32))) - set("\t\n\r\f")
"""Characters that no text has."""

MAX_FILE_BYTES = 2**28
"""Largest size of a file in bytes; nearly all of a valid one are arrays."""

PICKLE_START = b"\x80"
"""First byte of all pickles except the oldest protocols."""
ZIP_STARTS = (b"PK\x03\x04", b"PK\x05\x06")
"""First bytes of a zip, and of one without files."""


def load_content(path: Path) -> Any:
    """Return the contents of a file as plain containers, numbers, text and arrays, as from `unpickle`.

    An .npy file, a pickle, a file of `torch.save`, HDF5, JSON and YAML are distinguished by their first bytes, YAML by
    its name too. The content of a plain array file is an array.

    Raises:
        GraspFileError: it is missing, too large, damaged, or would run code.
    """
    # A pipe can be read only once.
    if is_file(path):
        refuse_lfs_pointer(path, "grasp file", GraspFileError)
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise GraspFileError(f"{path}: has {size / 2**20:.0f} MiB; at most {MAX_FILE_BYTES / 2**20:.0f} are read")
        with path.open("rb") as stream:
            # A file may have grown, and a pipe has no size.
            data = stream.read(MAX_FILE_BYTES + 1)
    except FileNotFoundError:
        raise GraspFileError(f"{path}: no such grasp file") from None
    except OSError as error:
        raise GraspFileError(f"{path}: cannot be read ({error.strerror or error})") from None
    if len(data) > MAX_FILE_BYTES:
        raise GraspFileError(f"{path}: has more than the {MAX_FILE_BYTES / 2**20:.0f} MiB that are read")
    return content_of(data, path)


def content_of(data: bytes, path: Path) -> Any:
    """Return the contents of the bytes of a file, as `load_content`; `path` names it in errors, and need not exist.

    Raises:
        GraspFileError: it is damaged, or would run code.
    """
    if not data:
        raise GraspFileError(f"{path}: is empty")
    try:
        if path.suffix.lower() == ".npz" and not is_torch_file(data):
            return _pickled_entries(io.BytesIO(data), len(data), path)
        return _read(data, path.suffix.lower())
    except Refused as error:
        if data.startswith((MAGIC, PICKLE_START, HDF5_MAGIC, *ZIP_STARTS)):
            raise GraspFileError(f"{path}: {error}") from None
        raise GraspFileError(
            f"{path}: {error}; it may not be a grasp file, which end with {', '.join(SUFFIXES)}"
        ) from None


def load_pickled_npz(path: Path) -> dict[str, Any] | None:
    """Return the entries of an .npz of another program, with objects in it; None: it has plain arrays only.

    Raises:
        GraspFileError: it is too large or damaged, or would run code.
    """
    if not _holds_objects(path):
        return None
    with path.open("rb") as file:
        return _pickled_entries(file, path.stat().st_size, path)


def _pickled_entries(file: IO[bytes], packed: int, path: Path) -> dict[str, Any]:
    """Entries of an .npz of some size; `path` names it in errors."""
    try:
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            size = sum(member.file_size for member in members)
            if size > min(MAX_GROWTH * packed + FREE_BYTES, MAX_FILE_BYTES):
                raise Refused(f"would unpack to {size / 2**20:.0f} MiB, far more than its {packed / 2**20:.1f} MiB")
            return {member.filename.removesuffix(".npy"): _read(archive.read(member), ".npy") for member in members}
    except Refused as error:
        raise GraspFileError(f"{path}: {error}") from None
    except ZIP_ERRORS as error:
        raise GraspFileError(f"{path}: not a readable .npz file ({' '.join(str(error).split())[:80]})") from None


def _holds_objects(path: Path) -> bool:
    """Return whether an .npz has an array of objects, which are pickled; false for a damaged one."""
    try:
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                with archive.open(member) as stream:
                    head = stream.read(MAX_HEADER_BYTES)
                if head.startswith(MAGIC) and array_header(head)[1].hasobject:
                    return True
    except ZIP_ERRORS:
        pass
    return False


def _read(data: bytes, suffix: str) -> Any:
    """Contents of the bytes of a file with some ending."""
    if data.startswith(MAGIC):
        return _array(data)
    if data.startswith(HDF5_MAGIC):
        return load_hdf5(data)
    if is_torch_file(data):
        return load_torch(data)
    if data.startswith(ZIP_STARTS):
        raise Refused("is a damaged zip archive, or one that torch.save did not write")
    if suffix == TOML_SUFFIX:
        return load_toml(data)
    if suffix not in YAML_SUFFIXES and is_json(data):
        return load_json(data)
    if suffix in YAML_SUFFIXES or is_yaml(data):
        return load_yaml(data)
    try:
        return unpickle(data)
    except Damaged:
        if data.startswith(PICKLE_START):
            raise
        known = "is no array file, pickle, torch file, HDF5, JSON or YAML"
        raise Refused("is plain text, such as CSV, which is not read" if _is_text(data) else known) from None


def _is_text(data: bytes) -> bool:
    """Return whether bytes are text, as in a CSV file."""
    try:
        return not set(data.decode("utf-8")) & CONTROLS
    except UnicodeDecodeError:
        return False


def _array(data: bytes) -> Any:
    """Contents of an array file."""
    try:
        shape, dtype, start = array_header(data)
    except ValueError as error:
        raise Refused(f"is a damaged .npy file: its header cannot be read ({error})") from None
    rest = data[start:]
    if dtype.hasobject:
        return unpickle(rest)
    if dtype.kind not in ARRAY_KINDS:
        raise Refused(f"holds an array of the type {dtype}; numbers or text are needed")
    needed = prod(shape) * dtype.itemsize
    if len(rest) < needed:
        raise Refused(f"is cut off: shape {shape} of {dtype} needs {needed} bytes, {len(rest)} are there")
    check_text(rest[:needed], dtype)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of headers by Python 2, or damaged ones
            return np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, OverflowError) as error:
        raise Refused(f"is a damaged .npy file ({' '.join(str(error).split())[:80]})") from None
