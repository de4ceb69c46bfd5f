"""Named experiments."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from types import MappingProxyType

from grasp_refine_apps.bench.queries.cases import STATE_DISTANCES_M, Case, cases_of
from grasp_refine_apps.bench.queries.measure import Measurement
from grasp_refine_apps.bench.queries.study import QueryStudy

BATCHES, VERTICES, PIECES = (1, 16, 256, 1024), (8, 32, 128, 512), (4, 16, 64)
"""Default values of the sweeps; `Case` has the defaults of the others."""

STATES = tuple(STATE_DISTANCES_M)

CONVEX, MIXED, CONCAVE = Case("convex"), Case("mixed", 16), Case("concave", 16)
"""Cases at which batches and states are compared."""


def _sweeps() -> tuple[Case, ...]:
    """Return cases with one quantity varied at a time."""
    over_batch = (Case(one.kind, one.pieces, batch=batch) for one in (CONVEX, MIXED, CONCAVE) for batch in BATCHES)
    over_vertices = (Case(vertices=count, state=state) for state in ("near", "deep") for count in VERTICES)
    over_pieces = (Case(kind, count) for kind in ("mixed", "concave") for count in PIECES)
    over_states = (Case(one.kind, one.pieces, state=state) for one in (CONVEX, CONCAVE) for state in STATES)
    return tuple(dict.fromkeys([*over_batch, *over_vertices, *over_pieces, *over_states]))


EXAMPLES = tuple(product(("allegro", "shadow"), ("mug", "rounded_box")))
"""Hands and objects of the skips."""

DEFAULT = QueryStudy(_sweeps(), EXAMPLES)
"""The default experiment."""

PRESETS: Mapping[str, QueryStudy] = MappingProxyType(
    {
        "full": QueryStudy(cases_of(("convex", "mixed", "concave"), PIECES, VERTICES, STATES, BATCHES), EXAMPLES),
        "skips": QueryStudy((), EXAMPLES),
        "smoke": QueryStudy(
            (Case(batch=16), Case(state="deep", batch=16), Case("mixed", 4, batch=16), Case("concave", 4, batch=16)),
            (("allegro", "rounded_box"),),
            count=4,
            measurement=Measurement(rounds=3, least_s=0.001),
        ),
    }
)
"""Name -> experiment."""
