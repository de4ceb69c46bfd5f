"""Named experiments, as lists of cases."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType

from grasp_refine_apps.bench.queries.cases import STATE_DISTANCES_M, Case, Kind, State
from grasp_refine_apps.bench.queries.skips_starting import COMMANDS

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
    commands: tuple[str, ...] = ()
    """Command lines whose imports are counted."""
    rounds: int = 7
    """Number of measurements of each time; medians count."""
    least_s: float = 0.004
    """Minimum CPU seconds of a measurement of a query, for which short calls are repeated."""
    count: int = 16
    """Grasps of each example: its own, then disturbed ones."""
    skip_rounds: int = 1
    """Number of measurements of each refinement, after an extra first one if there are several."""


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

DEFAULT = Preset(_sweeps(), EXAMPLES, COMMANDS)
"""The default experiment."""

PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "full": Preset(
            cases_of(("convex", "mixed", "concave"), PIECES, VERTICES, STATES, BATCHES),
            EXAMPLES,
            COMMANDS,
        ),
        "skips": Preset((), EXAMPLES, COMMANDS),
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
