"""Scaling of lengths, given for hand-sized bodies, to bodies of other sizes."""

from collections.abc import Sequence

import numpy as np

from grasp_refine.geometry.body import Body

MIN_DIAGONAL_M, MAX_DIAGONAL_M = 0.01, 1.0
"""Diagonals in metres between which lengths in metres are not scaled."""


def length_factor(a: Sequence[Body], b: Sequence[Body]) -> np.ndarray:
    """Factor (P,) on lengths in metres for pairs of bodies: 1 where the larger is 1 cm to 1 m long.

    Smaller and larger pairs are treated as scaled versions of pairs at the limit: for bodies of 1 mm, 10 um
    correspond to 100 um for bodies of 1 cm.

    Args:
        a: First bodies of the P pairs.
        b: Second bodies.
    """
    diagonal = np.array([max(one.diagonal, other.diagonal) for one, other in zip(a, b, strict=True)])
    return diagonal / np.clip(diagonal, MIN_DIAGONAL_M, MAX_DIAGONAL_M)
