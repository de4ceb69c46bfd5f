"""Arm that carries a hand: the joints between a base that stands still and the palm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Bool
from grasp_refine.core.short_repr import brief


@dataclass(frozen=True, eq=False)
class Arm:
    """The part of a `Hand` that carries the palm; its base stands still."""

    palm: str
    """Link of the palm: grasps of the hand alone give its pose."""
    joints: Bool[np.ndarray, " n"]
    """True (n,) for the independent joints between base and palm, the arm's."""
    links: frozenset[str]
    """Links of the arm: all links above the palm."""
    standing: frozenset[str]
    """Links of the arm that no joint moves, such as the base: the ground below them is no obstacle."""

    __repr__ = brief
