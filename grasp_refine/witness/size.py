"""How lengths that are given for bodies of the size of a hand follow bodies of other sizes."""

from collections.abc import Sequence

import numpy as np

from grasp_refine.geometry.body import Body

SMALLEST, LARGEST = 0.01, 1.0
"""Diagonals in metres between which a length in metres means just that."""


def length_factor(a: Sequence[Body], b: Sequence[Body]) -> np.ndarray:
    """What to multiply lengths in metres with, for pairs of bodies (P,): 1 where the larger is 1 cm to 1 m long.

    Smaller and larger pairs are taken as those with this limit for a diagonal, only scaled: of bodies of 1 mm, 10 um
    mean what 100 um mean of bodies of 1 cm.

    Args:
        a: First bodies of the P pairs.
        b: Second bodies.
    """
    diagonal = np.array([max(one.diagonal, other.diagonal) for one, other in zip(a, b, strict=True)])
    return diagonal / np.clip(diagonal, SMALLEST, LARGEST)
