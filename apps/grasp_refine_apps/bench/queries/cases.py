"""Cases of the benchmark: two bodies of some kind, their state, and the number of such pairs at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

Kind = Literal["convex", "mixed", "concave"]
"""One piece against one; one against several, as a link against an object; several against several."""

State = Literal["far", "near", "touching", "shallow", "deep"]
"""Relative state of the bodies, see `STATE_DISTANCES_M`."""

STATE_DISTANCES_M: dict[State, float] = {"far": 0.2, "near": 0.004, "touching": 0.0, "shallow": -0.001, "deep": -0.005}
"""Signed distance of the bodies in metres, which are 10 to 14 cm long."""


@dataclass(frozen=True)
class Case:
    """A case to be measured."""

    kind: Kind = "convex"
    pieces: int = 1
    """Pieces of each body, only of the second one where the kind is mixed; 1 where it is convex."""
    vertices: int = 32
    """Vertices of each piece."""
    state: State = "near"
    batch: int = 256
    """Poses in one call."""

    @property
    def sides(self) -> tuple[int, int]:
        """Pieces of the first and of the second body."""
        return (self.pieces if self.kind == "concave" else 1), (1 if self.kind == "convex" else self.pieces)

    @property
    def piece_pairs(self) -> int:
        """Piece pairs of the two bodies."""
        first, second = self.sides
        return first * second

    def columns(self) -> dict[str, Any]:
        """Settings as entries of a row."""
        return {
            "kind": self.kind,
            "pieces": self.pieces,
            "vertices": self.vertices,
            "state": self.state,
            "batch": self.batch,
        }
