"""The experiments that have a name: which bodies, in which states, are asked in which ways."""

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
    diagonals_of,
)
from grasp_refine_apps.bench.stability.rows import Measure
from grasp_refine_apps.bench.stability.task import Task

SMOOTHING: tuple[Method, ...] = ("contact-kinematics", "distance", "direction")
"""Methods that look at candidates near a witness point; the others have no neighborhood."""

SLOW: tuple[Kind, ...] = ("hull1000", "concave40", "slivers")
"""Kinds whose reference takes seconds, as the difference of their bodies has many vertices."""

FAST = tuple(kind for kind in KINDS if kind not in SLOW)
"""All others."""


@dataclass(frozen=True)
class Part:
    """A part of an experiment."""

    kinds: tuple[Kind, ...] = KINDS
    """Which bodies."""
    diagonals: tuple[float, ...] | None = None
    """Diagonals of the larger body in metres; None: all there are for a kind."""
    states: tuple[State, ...] = STATES
    """How they lie to each other."""
    measures: tuple[Measure, ...] = ("forward", "derivative")
    """Whether distances are judged, and whether derivatives are."""
    dtypes: tuple[DType, ...] = DTYPES
    """Of poses."""
    batches: tuple[int, ...] = (64, 1, 7)
    """Poses in one call."""
    translations: tuple[float, ...] = TRANSLATIONS
    """How far from the origin of the world the bodies are when distances are asked for, in metres."""
    methods: tuple[Method, ...] = METHODS
    """How points are differentiated."""
    neighborhoods: tuple[Neighborhood, ...] = NEIGHBORHOODS
    """Which candidates stand for the surface."""
    queries: int = 64
    """Pairs of poses for each state, way of asking and translation."""
    differentiated: int = 16
    """Pairs of poses for each state and derivative."""
    mujoco: int = 16
    """Pairs of poses of each state that MuJoCo is asked too."""

    def tasks(self, engines: tuple[Engine, ...], seed: int) -> tuple[Task, ...]:
        """All of it, a task for each kind and size.

        Args:
            engines: Who answers.
            seed: Of bodies and poses.
        """
        forward, derivative = (measure in self.measures for measure in ("forward", "derivative"))
        # What is not used is left out, so that tasks that ask the same are the same.
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
    """Ways to ask: the first of each, then what differs in one thing from it."""
    first = Forward(dtypes[0], batches[0], engines[0])
    ways = [replace(first, dtype=dtype) for dtype in dtypes]
    ways += [replace(first, batch=batch) for batch in batches]
    ways += [replace(first, engine=engine) for engine in engines]
    return list(dict.fromkeys(ways))


def derivatives_of(
    methods: Sequence[Method], neighborhoods: Sequence[Neighborhood], dtypes: Sequence[DType]
) -> list[Derivative]:
    """Every combination; methods without candidates have no neighborhood."""
    every = product(methods, neighborhoods, dtypes)
    found = (Derivative(method, near if method in SMOOTHING else None, dtype) for method, near, dtype in every)
    return list(dict.fromkeys(found))


QUICK: dict[str, Any] = {
    "measures": ("forward",), "batches": (16, 1), "translations": (0.0, 1e3), "queries": 12, "mujoco": 2
}  # fmt: skip
"""How distances are asked for in `quick`."""

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
