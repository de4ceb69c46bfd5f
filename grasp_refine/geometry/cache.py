"""What is costly to find, on disk: one .npz file for each geometry and settings, named by their hash.

Convex decompositions are the main kind; others keep arrays of their own.
"""

from __future__ import annotations

import hashlib
import os
import struct
import tempfile
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

BROKEN: tuple[type[Exception], ...]
BROKEN = (OSError, EOFError, LookupError, ValueError, TypeError, SyntaxError, RuntimeError, MemoryError)
BROKEN += (zipfile.BadZipFile, zlib.error, tokenize.TokenError, struct.error)
"""How an entry shows that something else has written it, or only half of it."""

SCHEMA = 1
"""Layout of an entry and of what goes into its name; a new one leaves all old entries unused."""

Polytope = tuple[np.ndarray, np.ndarray]
"""Vertices (V, 3) and triangles (F, 3)."""


def default_cache(kind: str = "pieces") -> Path:
    """The folder of one kind of entries: $GRASP_REFINE_CACHE/kind, else `kind` in the user's cache folder."""
    root = os.environ.get("GRASP_REFINE_CACHE") or platformdirs.user_cache_dir("grasp-refine")
    return Path(root) / kind


def entry_name(vertices: np.ndarray, faces: np.ndarray, settings: str) -> str:
    """File name of the entry for a geometry and the text of all `settings` that what is kept depends on."""
    digest = hashlib.sha256(f"{SCHEMA} {vertices.shape} {faces.shape} {settings}".encode())
    digest.update(vertices.astype("<f8").tobytes())
    digest.update(faces.astype("<i8").tobytes())
    return f"{digest.hexdigest()}.npz"


def save(entry: Path, polytopes: Sequence[Polytope]) -> None:
    """Nothing; the polytopes are kept as `save_arrays` does.

    Raises:
        OSError: the folder cannot be written to.
    """
    vertices, faces = zip(*polytopes, strict=True)
    save_arrays(
        entry,
        vertices=np.concatenate(vertices),
        faces=np.concatenate(faces),
        vertex_counts=np.array([len(part) for part in vertices]),
        face_counts=np.array([len(part) for part in faces]),
    )


def save_arrays(entry: Path, **arrays: Any) -> None:
    """Nothing; the entry appears complete or not at all, also when several processes write it.

    Raises:
        OSError: the folder cannot be written to.
    """
    entry.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=entry.parent, suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **arrays)
        os.replace(temporary, entry)
    except BaseException:
        os.unlink(temporary)
        raise


def load(entry: Path) -> list[Polytope] | None:
    """The polytopes of an entry; None when there is no such entry, or it is broken."""
    arrays = load_arrays(entry, "vertices", "faces", "vertex_counts", "face_counts")
    if arrays is None or not _sound(*arrays):
        return None
    vertices, faces, *counts = arrays
    per_vertex, per_face = (np.cumsum(count)[:-1] for count in counts)
    return list(zip(np.split(vertices, per_vertex), np.split(faces, per_face), strict=True))


def load_arrays(entry: Path, *names: str) -> list[np.ndarray] | None:
    """The arrays of an entry with these names; None when there is no such entry, or it cannot be read."""
    try:
        # numpy leaves a file open that it opened itself and could not read.
        with open(entry, "rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of heads that Python 2 wrote, or nobody
            with np.load(file, allow_pickle=False) as arrays:
                found = [arrays[name] for name in names]
    except BROKEN:
        return None
    return found if all(isinstance(array, np.ndarray) for array in found) else None


def _sound(vertices: np.ndarray, faces: np.ndarray, per_vertex: np.ndarray, per_face: np.ndarray) -> bool:
    """Whether the arrays of an entry are of the right kind and fit each other."""
    if [a.dtype for a in (vertices, faces, per_vertex, per_face)] != [
        np.float64,
        np.int64,
        np.int64,
        np.int64,
    ]:
        return False
    if not (vertices.ndim == faces.ndim == 2 and vertices.shape[1] == faces.shape[1] == 3):
        return False
    if not (per_vertex.ndim == 1 and per_vertex.shape == per_face.shape and len(per_face) > 0):
        return False
    if not (per_vertex.min() >= 4 and per_face.min() >= 4):
        return False
    if not (per_vertex.sum() == len(vertices) and per_face.sum() == len(faces)):
        return False
    limits = np.repeat(per_vertex, per_face)[:, None]
    return bool(np.isfinite(vertices).all() and (faces >= 0).all() and (faces < limits).all())
