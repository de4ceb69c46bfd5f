"""Hypothesis: a solid that a scanned object may be."""

from __future__ import annotations

from dataclasses import dataclass

from grasp_refine.geometry.pieces import Piece


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Solid that a scanned object may be, expressed in the frame of the object."""

    kind: str
    """Name of the way in which the unseen part is completed, such as "mirrored"."""
    pieces: tuple[Piece, ...]
    """Convex pieces."""
    weight: float
    """Probability; those of all hypotheses of a scan sum to 1."""
