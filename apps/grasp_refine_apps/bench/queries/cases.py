"""Cases of the benchmark: two bodies in some state, in a batch of poses."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Literal

Kind = Literal["convex", "mixed", "concave"]
"""One piece against one; one against several, as a link against an object; several against several."""

State = Literal["far", "near", "touching", "shallow", "deep"]
"""Relative state of the bodies, see `STATE_DISTANCES_M`."""

STATE_DISTANCES_M: dict[State, float] = {"far": 0.2, "near": 0.004, "touching": 0.0, "shallow": -0.001, "deep": -0.005}
"""Signed distance of the bodies in metres, which are 10 to 14 cm long."""


@dataclass(frozen=True)
class Case:
    """A case to be measured; its fields are entries of a row."""

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


def cases_of(
    kinds: tuple[Kind, ...],
    pieces: tuple[int, ...],
    vertices: tuple[int, ...],
    states: tuple[State, ...],
    batches: tuple[int, ...],
) -> tuple[Case, ...]:
    """Return every combination; convex bodies have one piece."""
    found = (
        Case(kind, 1 if kind == "convex" else count, corners, state, batch)
        for kind, count, corners, state, batch in product(kinds, pieces, vertices, states, batches)
    )
    return tuple(dict.fromkeys(found))
