"""New starts of alignment tasks that stall: random rotations of body b about its target.

A large rotation of the present pose alternates with a small one of the best pose.
"""

from __future__ import annotations

from zlib import crc32

import numpy as np

NEAR_ANGLES_RAD, FAR_ANGLES_RAD = (0.003, 0.5), (0.3, np.pi)
"""Ranges of angles in radians: small (log-uniform), and large."""


def generator(seed: int, T_world_b: np.ndarray, start: int) -> np.random.Generator:
    """Return the random numbers of a task's start: of the initial pose (4, 4) of its body b, not of other tasks."""
    return np.random.default_rng((seed, crc32(T_world_b.tobytes()), start))


def random_rotation(rng: np.random.Generator, *, far: bool) -> np.ndarray:
    """Draw a rotation vector (3,) in radians, large or small."""
    axis = rng.normal(size=3)
    angle = rng.uniform(*FAR_ANGLES_RAD) if far else np.exp(rng.uniform(*np.log(NEAR_ANGLES_RAD)))
    return axis / np.linalg.norm(axis) * angle
