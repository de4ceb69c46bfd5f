"""Contents of a file of another program: an array file or a pickle, read without running anything, of bounded size."""

from __future__ import annotations

import io
import warnings
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.npz_files import MAGIC, array_header
from grasp_refine.grasps.formats.pickled import ARRAY_KINDS, Refused, check_text, unpickle

MAX_FILE_BYTES = 2**28
"""Largest size of a file in bytes; nearly all of a valid one are arrays."""

PICKLE_START = b"\x80"
"""First byte of all pickles but those of the oldest protocols."""


def load_content(path: Path) -> Any:
    """Return the contents of an .npy file or a pickle, as from `unpickle`; those of a plain array file are an array.

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
        return _array(data) if data.startswith(MAGIC) else unpickle(data)
    except Refused as error:
        if data.startswith((MAGIC, PICKLE_START)):
            raise GraspFileError(f"{path}: {error}") from None
        raise GraspFileError(
            f"{path}: {error}; it may not be a grasp file: ours are .npz, those of other programs .npy or pickles"
        ) from None


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
