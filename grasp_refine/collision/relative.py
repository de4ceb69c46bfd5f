"""Relative poses and vectors in the frames of bodies.

Sums are written out, because the order of their terms decides the last bit, and a bit may decide how many steps GJK
takes: the compiled engine has the same order. Items are the last axis, so that each term is one long operation.
"""

import numpy as np


def relative(T_a: np.ndarray, T_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (M, 3, 3) and origins (M, 3) of bodies b in the frames of bodies a, from world poses (M, 4, 4)."""
    a, b = _items_last(T_a)[:3], _items_last(T_b)[:3]
    b[:, 3] -= a[:, 3]
    found = _rotate_back(a, b)
    return np.ascontiguousarray(np.moveaxis(found[:, :3], -1, 0)), np.ascontiguousarray(found[:, 3].T)


def in_frame(T_a: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """World vectors (M, 3) expressed in the frames of bodies a at the poses (M, 4, 4)."""
    return np.ascontiguousarray(_rotate_back(_items_last(T_a), _items_last(vectors[..., None]))[:, 0].T)


def _items_last(array: np.ndarray) -> np.ndarray:
    """A copy (m, n, M) of an array (M, m, n)."""
    return np.array(np.moveaxis(array, 0, -1), order="C")


def _rotate_back(T: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """R^T times columns (3, n, M), with the rotations R of poses T (.., .., M)."""
    found = T[0, :3, None] * columns[0]
    found += T[1, :3, None] * columns[1]
    found += T[2, :3, None] * columns[2]
    return found
