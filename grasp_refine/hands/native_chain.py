"""Kinematics, compiled: `chain` in C++ (see `collision/native/chain.h`)."""

from __future__ import annotations

import numpy as np

# Loads coal's library, which _native needs.
from grasp_refine.collision.native_search import threads_for

from grasp_refine.collision import _native  # type: ignore[attr-defined]  # compiled  # isort: skip

_POSES_PER_THREAD = 64
"""Fewest configurations for another thread."""


class NativeChain:
    """The constants of a chain in C++; results are the same for any number of threads and of configurations."""

    def __init__(self, *constants: np.ndarray | None, shape: tuple[int, int, int]) -> None:
        """Take over the constants, in the order of `Tree` in C++; numbers of links, columns of axes and unknowns."""
        self._shape = shape
        self._tree = _native.Tree(*(None if each is None else np.ascontiguousarray(each) for each in constants))

    def forward(self, T_world_root: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return poses (M, L, 4, 4) of the links and axes (M, 6, 6 + k), as of `Frames`."""
        links, columns, _ = self._shape
        T_link, axes = np.empty((len(q), links, 4, 4)), np.empty((len(q), 6, columns))
        T_root, q = np.ascontiguousarray(T_world_root, dtype=np.float64), np.ascontiguousarray(q)
        self._tree.forward(T_root, q, T_link, axes, threads_for(len(q), _POSES_PER_THREAD))
        return T_link, axes

    def to_joint_space(
        self, axes: np.ndarray, covector: np.ndarray, link: np.ndarray, minus: np.ndarray | None
    ) -> np.ndarray:
        """Return the result of `Chain.to_joint_space`, with its arguments."""
        M, R = covector.shape[:2]
        out = np.empty((M, R, self._shape[2]))
        axes, covector = (np.ascontiguousarray(each, dtype=np.float64) for each in (axes, covector))
        link = np.ascontiguousarray(link, dtype=np.int64)
        minus = None if minus is None else np.ascontiguousarray(minus, dtype=np.int64)
        self._tree.to_joints(axes, covector, link, minus, out, threads_for(M, _POSES_PER_THREAD))
        return out
