"""Named experiments: bodies, states and settings of queries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from types import MappingProxyType
from typing import Any

from grasp_refine_apps.bench.stability.cases import (
    DTYPES,
    FEATURES,
    KINDS,
    METHODS,
    NEIGHBORHOODS,
    STATES,
    TRANSLATIONS,
    Derivative,
    DType,
    Engine,
    Forward,
    Kind,
    Method,
    Neighborhood,
    State,
    Task,
    diagonals_of,
)
from grasp_refine_apps.bench.stability.rows import Measure

SMOOTHING: tuple[Method, ...] = ("contact-kinematics", "distance", "direction")
"""Methods that use candidates near a witness point; the others have no neighborhood."""

SLOW: tuple[Kind, ...] = ("hull1000", "concave40", "slivers")
"""Kinds whose reference takes seconds, as the difference of their bodies has many vertices."""

FAST = tuple(kind for kind in KINDS if kind not in SLOW)
"""All other kinds."""


@dataclass(frozen=True)
class Part:
    """A part of an experiment."""

    kinds: tuple[Kind, ...] = KINDS
    """Kinds of bodies."""
    diagonals: tuple[float, ...] | None = None
    """Diagonals of the larger body in metres; None: all of a kind."""
    states: tuple[State, ...] = STATES
    """Relative states of the bodies."""
    measures: tuple[Measure, ...] = ("forward", "derivative")
    """Measures: distances, derivatives or both."""
    dtypes: tuple[DType, ...] = DTYPES
    """Precisions of poses."""
    batches: tuple[int, ...] = (64, 1, 7)
    """Poses in one call."""
    translations: tuple[float, ...] = TRANSLATIONS
    """Distances of the bodies from the origin of the world for queries of distances, in metres."""
    methods: tuple[Method, ...] = METHODS
    """Derivative methods of the witness points."""
    neighborhoods: tuple[Neighborhood, ...] = NEIGHBORHOODS
    """Neighbourhoods of candidates that represent the surface."""
    queries: int = 64
    """Pairs of poses for each state, way to query and translation."""
    differentiated: int = 16
    """Pairs of poses for each state and derivative."""
    mujoco: int = 16
    """Pairs of poses of each state that MuJoCo is also queried at."""

    def tasks(self, engines: tuple[Engine, ...], seed: int) -> tuple[Task, ...]:
        """Make all tasks, one for each kind and size.

        Args:
            engines: Collision engines.
            seed: Seed of bodies and poses.
        """
        forward, derivative = (measure in self.measures for measure in ("forward", "derivative"))
        # Unused settings are left out, so that equal tasks compare equal.
        ways: dict[str, Any] = {
            "forwards": tuple(forwards_of(self.dtypes, self.batches, engines)),
            "translations": self.translations,
            "queries": self.queries,
            "mujoco": self.mujoco,
        }
        moves: dict[str, Any] = {
            "derivatives": tuple(derivatives_of(self.methods, self.neighborhoods, self.dtypes)),
            "differentiated": self.differentiated,
        }
        none: dict[str, Any] = {"mujoco": 0}
        asked = (ways if forward else none) | (moves if derivative else {})
        return tuple(
            Task(kind, diagonal, self.states, seed=seed, **asked)
            for kind in self.kinds
            for diagonal in self.diagonals or diagonals_of(kind)
        )


def forwards_of(dtypes: Sequence[DType], batches: Sequence[int], engines: Sequence[Engine]) -> list[Forward]:
    """Return settings of queries: the first value of each, then combinations that differ in one of them."""
    first = Forward(dtypes[0], batches[0], engines[0])
    ways = [replace(first, dtype=dtype) for dtype in dtypes]
    ways += [replace(first, batch=batch) for batch in batches]
    ways += [replace(first, engine=engine) for engine in engines]
    return list(dict.fromkeys(ways))


def derivatives_of(
    methods: Sequence[Method], neighborhoods: Sequence[Neighborhood], dtypes: Sequence[DType]
) -> list[Derivative]:
    """Return every combination; methods without candidates have no neighborhood."""
    every = product(methods, neighborhoods, dtypes)
    found = (Derivative(method, near if method in SMOOTHING else None, dtype) for method, near, dtype in every)
    return list(dict.fromkeys(found))


QUICK: dict[str, Any] = {
    "measures": ("forward",), "batches": (16, 1), "translations": (0.0, 1e3), "queries": 12, "mujoco": 2
}  # fmt: skip
"""Ways to query distances in `quick`."""

PRESETS: Mapping[str, tuple[Part, ...]] = MappingProxyType(
    {
        "full": (Part(),),
        "quick": (
            Part(FAST, (1e-4, 0.1), **QUICK),
            Part(SLOW, (10.0,), tuple(state for state in STATES if state not in FEATURES), **QUICK),
            Part(
                FAST, (1e-3,), measures=("derivative",), dtypes=("float64",), neighborhoods=("adaptive",),
                differentiated=1,
            ),
        ),
        "smoke": (
            Part(
                ("ball", "box", "needle"), (1e-3, 0.1), batches=(8,), translations=(0.0,), queries=8, mujoco=2,
                neighborhoods=("adaptive",), differentiated=1,
            ),
        ),
    }
)  # fmt: skip
"""Name -> experiment."""
