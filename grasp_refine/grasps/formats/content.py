"""What a file of another program holds: an array file or a pickle, read without running anything, of bounded size."""

from __future__ import annotations

import io
import warnings
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.npz_files import MAGIC, array_header
from grasp_refine.grasps.formats.pickled import KINDS, Refused, unpickled

LARGEST_FILE = 2**28
"""Larger files, in bytes, are not read: nearly all of one that is honest are arrays."""

PROTOCOL = b"\x80"
"""What all pickles but the oldest begin with."""


def load_content(path: Path) -> Any:
    """What an .npy file or a pickle holds, as `unpickled` gives it; a plain array file is an array.

    Raises:
        GraspFileError: it is missing, too large, damaged, or would run code.
    """
    try:
        size = path.stat().st_size
        if size > LARGEST_FILE:
            raise GraspFileError(f"{path}: has {size / 2**20:.0f} MiB; at most {LARGEST_FILE / 2**20:.0f} are read")
        with path.open("rb") as stream:
            # A file may have grown, and a pipe has no size.
            data = stream.read(LARGEST_FILE + 1)
    except FileNotFoundError:
        raise GraspFileError(f"{path}: no such grasp file") from None
    except OSError as error:
        raise GraspFileError(f"{path}: cannot be read ({error.strerror or error})") from None
    if len(data) > LARGEST_FILE:
        raise GraspFileError(f"{path}: has more than the {LARGEST_FILE / 2**20:.0f} MiB that are read")
    if not data:
        raise GraspFileError(f"{path}: is empty")
    try:
        return _array(data) if data.startswith(MAGIC) else unpickled(data)
    except Refused as error:
        if data.startswith((MAGIC, PROTOCOL)):
            raise GraspFileError(f"{path}: {error}") from None
        raise GraspFileError(
            f"{path}: {error}; it may be no grasp file: those of ours are .npz, those of other programs .npy or pickles"
        ) from None


def _array(data: bytes) -> Any:
    """What an array file holds."""
    try:
        shape, dtype, start = array_header(data)
    except ValueError as error:
        raise Refused(f"is a damaged .npy file: its header cannot be read ({error})") from None
    rest = data[start:]
    if dtype.hasobject:
        return unpickled(rest)
    if dtype.kind not in KINDS:
        raise Refused(f"holds an array of the type {dtype}; numbers or text are needed")
    needed = prod(shape) * dtype.itemsize
    if len(rest) < needed:
        raise Refused(f"is cut off: shape {shape} of {dtype} needs {needed} bytes, {len(rest)} are there")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of heads that Python 2 wrote, or nobody
            return np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, OverflowError) as error:
        raise Refused(f"is a damaged .npy file ({' '.join(str(error).split())[:80]})") from None
