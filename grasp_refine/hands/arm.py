"""Arm that carries a hand: the joints between a base that stands still and the palm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from grasp_refine.core.short_repr import brief


@dataclass(frozen=True, eq=False)
class Arm:
    """The part of a `Hand` that carries the palm; its base stands still."""

    palm: str
    """Link whose pose is the palm's: what grasps of the hand alone give poses of."""
    joints: Bool[np.ndarray, " n"]
    """True (n,) for the independent joints between base and palm, the arm's."""
    links: frozenset[str]
    """Links of the arm: those that are not at or below the palm."""
    standing: frozenset[str]
    """Those of them that no joint moves, such as the base: what they stand on or in is no obstacle."""

    __repr__ = brief
