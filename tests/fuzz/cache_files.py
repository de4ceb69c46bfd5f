"""Entries of the cache, which are read, or made anew where they are broken, but never a reason to stop."""

from __future__ import annotations

from collections.abc import Hashable
from functools import cache
from pathlib import Path

import numpy as np

from fuzz.npz_files import WORDS, archive, change, member
from fuzz.reader import Reader
from grasp_refine.geometry.cache import load, load_arrays
from grasp_refine.geometry.pieces import box, hull


@cache
def seeds() -> tuple[tuple[str, bytes], ...]:
    """Two pieces, and an array."""
    pieces = [box([1, 2, 3]), hull(np.random.default_rng(0).normal(size=(20, 3)))]
    arrays = {
        "vertices": np.concatenate([piece.vertices for piece in pieces]),
        "faces": np.concatenate([piece.faces for piece in pieces]),
        "vertex_counts": np.array([len(piece.vertices) for piece in pieces]),
        "face_counts": np.array([len(piece.faces) for piece in pieces]),
        "touching": np.zeros((2, 2), bool),
    }
    return (("entry.npz", archive({f"{name}.npy": member(array) for name, array in arrays.items()})),)


def read(path: Path) -> Hashable:
    """What is in it, None where it is broken."""
    found = load(path)
    for vertices, faces in found or ():
        assert np.isfinite(vertices).all() and faces.min() >= 0 and faces.max() < len(vertices)
    return found is None, load_arrays(path, "touching") is None


READER = Reader("cache", seeds, read, change, WORDS)
