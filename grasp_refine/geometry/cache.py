"""Disk cache of costly results: one .npz file for each geometry and settings, named by their hash.

Most entries are convex decompositions; others hold arrays of their own.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import platformdirs

from grasp_refine.core.errors import GraspFileError
from grasp_refine.core.npz_files import load_npz, save_npz

SCHEMA = 1
"""Version of an entry's layout and of its name's hash; a new one leaves all old entries unused."""

Polytope = tuple[np.ndarray, np.ndarray]
"""Vertices (V, 3) and triangles (F, 3)."""


def default_cache(kind: str = "pieces") -> Path:
    """Folder of one kind of entries: $GRASP_REFINE_CACHE/kind, else `kind` in the user's cache folder."""
    root = os.environ.get("GRASP_REFINE_CACHE") or platformdirs.user_cache_dir("grasp-refine")
    return Path(root) / kind


def entry_name(vertices: np.ndarray, faces: np.ndarray, settings: str) -> str:
    """File name of the entry for a geometry and the text of all `settings` that affect the result."""
    digest = hashlib.sha256(f"{SCHEMA} {vertices.shape} {faces.shape} {settings}".encode())
    digest.update(vertices.astype("<f8").tobytes())
    digest.update(faces.astype("<i8").tobytes())
    return f"{digest.hexdigest()}.npz"


def save(entry: Path, polytopes: Sequence[Polytope]) -> None:
    """Save polytopes as one entry, atomically, also when several processes or threads write it.

    Raises:
        GraspFileError: the folder is not writable.
    """
    vertices, faces = zip(*polytopes, strict=True)
    save_npz(
        entry,
        {
            "vertices": np.concatenate(vertices),
            "faces": np.concatenate(faces),
            "vertex_counts": [len(part) for part in vertices],
            "face_counts": [len(part) for part in faces],
        },
    )


def load(entry: Path) -> list[Polytope] | None:
    """Return the polytopes of an entry; None when there is no such entry, or it is broken."""
    arrays = load_arrays(entry, "vertices", "faces", "vertex_counts", "face_counts")
    if arrays is None or not _is_valid(*arrays):
        return None
    vertices, faces, *counts = arrays
    per_vertex, per_face = (np.cumsum(count)[:-1] for count in counts)
    return list(zip(np.split(vertices, per_vertex), np.split(faces, per_face), strict=True))


def load_arrays(entry: Path, *names: str) -> list[np.ndarray] | None:
    """Return the arrays of an entry by name; None when there is no such entry, or it cannot be read."""
    try:
        arrays = load_npz(entry, only=names).entries
    except GraspFileError:
        return None
    return [arrays[name] for name in names] if set(names) <= set(arrays) else None


def _is_valid(vertices: np.ndarray, faces: np.ndarray, per_vertex: np.ndarray, per_face: np.ndarray) -> bool:
    """Return whether the arrays of an entry have the right types and consistent shapes."""
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
