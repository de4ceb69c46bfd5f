"""Contents of a file of another program, whatever holds them: read without running anything, of bounded size."""

from __future__ import annotations

import io
import warnings
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.npz_files import MAGIC, array_header
from grasp_refine.grasps.formats.hdf5_files import HDF5_MAGIC, load_hdf5
from grasp_refine.grasps.formats.pickled import ARRAY_KINDS, Refused, check_text, unpickle
from grasp_refine.grasps.formats.texts import YAML_SUFFIXES, is_json, is_yaml, load_json, load_yaml
from grasp_refine.grasps.formats.torch_files import is_torch_file, load_torch

ARRAY_SUFFIXES = (".npz", ".npy", ".pickle", ".pkl")
"""Endings of files that can hardly be anything but grasps in a folder of such."""
OTHER_SUFFIXES = (".yaml", ".yml", ".json", ".pt", ".pth", ".h5", ".hdf5")
"""Endings of files that may be grasps, or what lies beside them."""
SUFFIXES = (*ARRAY_SUFFIXES, *OTHER_SUFFIXES)
"""Endings of grasp files."""

MAX_FILE_BYTES = 2**28
"""Largest size of a file in bytes; nearly all of a valid one are arrays."""

PICKLE_START = b"\x80"
"""First byte of all pickles but those of the oldest protocols."""


def load_content(path: Path) -> Any:
    """Return the contents of a file as plain containers, numbers, text and arrays, as from `unpickle`.

    An .npy file, a pickle, a file of `torch.save`, HDF5, JSON and YAML are told apart by how they begin, YAML by its
    name too. Those of a plain array file are an array.

    Raises:
        GraspFileError: it is missing, too large, damaged, or would run code.
    """
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
    if not data:
        raise GraspFileError(f"{path}: is empty")
    try:
        return _read(data, path.suffix.lower())
    except Refused as error:
        if data.startswith((MAGIC, PICKLE_START, HDF5_MAGIC)):
            raise GraspFileError(f"{path}: {error}") from None
        raise GraspFileError(
            f"{path}: {error}; it may not be a grasp file, which end with {', '.join(SUFFIXES)}"
        ) from None


def _read(data: bytes, suffix: str) -> Any:
    """Contents of the bytes of a file with some ending."""
    if data.startswith(MAGIC):
        return _array(data)
    if data.startswith(HDF5_MAGIC):
        return load_hdf5(data)
    if is_torch_file(data):
        return load_torch(data)
    if suffix not in YAML_SUFFIXES and is_json(data):
        return load_json(data)
    if suffix in YAML_SUFFIXES or is_yaml(data):
        return load_yaml(data)
    return unpickle(data)


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
