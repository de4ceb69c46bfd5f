"""Cases of the benchmark, two bodies in some state in a batch of poses, and named experiments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType
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


BATCHES, VERTICES, PIECES = (1, 16, 256, 1024), (8, 32, 128, 512), (4, 16, 64)
"""Default values of the sweeps; `Case` has the defaults of the others."""

STATES = tuple(STATE_DISTANCES_M)

CONVEX, MIXED, CONCAVE = Case("convex"), Case("mixed", 16), Case("concave", 16)
"""Cases at which batches and states are compared."""


@dataclass(frozen=True)
class Preset:
    """An experiment."""

    cases: tuple[Case, ...] = ()
    """Cases to measure."""
    examples: tuple[tuple[str, str], ...] = ()
    """Hands and objects whose example grasps show the savings of skips."""
    rounds: int = 7
    """Number of measurements of each time; medians count."""
    least_s: float = 0.004
    """Minimum CPU seconds of a measurement of a query, for which short calls are repeated."""
    count: int = 16
    """Grasps of each example: its own, then disturbed ones."""


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


def _sweeps() -> tuple[Case, ...]:
    """Return cases with one thing varied at a time."""
    over_batch = (Case(one.kind, one.pieces, batch=batch) for one in (CONVEX, MIXED, CONCAVE) for batch in BATCHES)
    over_vertices = (Case(vertices=count, state=state) for state in ("near", "deep") for count in VERTICES)
    over_pieces = (Case(kind, count) for kind in ("mixed", "concave") for count in PIECES)
    over_states = (Case(one.kind, one.pieces, state=state) for one in (CONVEX, CONCAVE) for state in STATES)
    return tuple(dict.fromkeys([*over_batch, *over_vertices, *over_pieces, *over_states]))


EXAMPLES = tuple(product(("allegro", "shadow"), ("mug", "rounded_box")))
"""Hands and objects of the skips."""

DEFAULT = Preset(_sweeps(), EXAMPLES)
"""The default experiment."""

PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "full": Preset(cases_of(("convex", "mixed", "concave"), PIECES, VERTICES, STATES, BATCHES), EXAMPLES),
        "skips": Preset((), EXAMPLES),
        "smoke": Preset(
            (Case(batch=16), Case(state="deep", batch=16), Case("mixed", 4, batch=16), Case("concave", 4, batch=16)),
            (("allegro", "rounded_box"),),
            rounds=3,
            least_s=0.001,
            count=4,
        ),
    }
)
"""Name -> experiment."""
