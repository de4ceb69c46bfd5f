"""Cases of the benchmark: kind, size and state of bodies, engines, derivative methods, precisions; and tasks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, cast, get_args

Kind = Literal["ball", "box", "needle", "plate", "hull1000", "concave40", "duplicates", "near-duplicates", "slivers"]
"""Kind of bodies, see `bodies`."""

KINDS: tuple[Kind, ...] = get_args(Kind)

DIAGONALS = (1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0)
"""Diagonals in metres of the larger body of a pair."""

SMALLEST_BOX = 1e-6
"""Smallest diagonal of boxes, besides `DIAGONALS`, in metres."""

State = Literal[
    "far",
    "near",
    "gap-1e-3",
    "gap-1e-4",
    "gap-1e-5",
    "gap-1e-6",
    "gap-1e-7",
    "gap-1e-8",
    "gap-1e-9",
    "gap-1e-10",
    "gap-1e-11",
    "gap-1e-12",
    "gap-1um",
    "gap-1nm",
    "contact",
    "face-face",
    "edge-edge",
    "vertex-vertex",
    "shallow",
    "deep",
    "total",
    "concentric",
]
"""Relative state of the bodies.

- far, near, gap-1e-3 .. gap-1e-12: apart by 1000, 0.05, 1e-3 .. 1e-12 diagonals, features of any kind nearest;
- gap-1um, gap-1nm: apart by 1e-6 m and 1e-9 m, whatever the size;
- contact: apart by 0, up to rounding;
- face-face, edge-edge, vertex-vertex: two of these features lie against each other, with one of `GAPS` between them;
- shallow, deep: from where they touch 1e-9 .. 1e-2 and 0.02 .. 0.2 diagonals inwards along the normal;
- total: the middle of one body near the middle of the other; concentric: equal middles, half with parallel axes.
"""

STATES: tuple[State, ...] = get_args(State)

STATE_DISTANCES: Mapping[State, float] = MappingProxyType(
    cast(
        dict[State, float],
        {"far": 1e3, "near": 0.05, "contact": 0.0} | {f"gap-1e-{n}": 10.0**-n for n in range(3, 13)},
    )
)
"""Distances of the states in which the bodies are apart, in diagonals."""

STATE_DISTANCES_M: Mapping[State, float] = MappingProxyType({"gap-1um": 1e-6, "gap-1nm": 1e-9})
"""Distances of the states in which the bodies are apart, in metres."""

GAPS = (0.0, 1e-12, 1e-9, 1e-6, 1e-3, -1e-9, -1e-6, -1e-3)
"""Distances between two features that lie against each other, in diagonals."""

FEATURES: tuple[State, ...] = ("face-face", "edge-edge", "vertex-vertex")
"""States of two features; a sphere has none."""

DType = Literal["float64", "float32"]
"""Precision of poses and answers."""

DTYPES: tuple[DType, ...] = get_args(DType)

Engine = Literal["native", "python"]
"""Collision engine."""

ENGINES: tuple[Engine, ...] = get_args(Engine)

Method = Literal["contact-kinematics", "distance", "direction", "analytical", "zeroth-order", "finite-difference"]
"""Derivative method of the witness points."""

METHODS: tuple[Method, ...] = get_args(Method)

Neighborhood = Literal["adaptive", "fixed"]
"""Neighbourhood of candidates that represents the surface near a witness point."""

NEIGHBORHOODS: tuple[Neighborhood, ...] = get_args(Neighborhood)

TRANSLATIONS = (0.0, 1.0, 1e3, 1e6)
"""Distances of the bodies from the origin of the world, in metres."""


@dataclass(frozen=True)
class Forward:
    """A way to query distances and points."""

    dtype: DType = "float64"
    batch: int = 256
    """Poses in one call."""
    engine: Engine = "native"


@dataclass(frozen=True)
class Derivative:
    """A way to differentiate distances and points."""

    method: Method = "contact-kinematics"
    neighborhood: Neighborhood | None = "adaptive"
    """Neighbourhood; None: the method uses no candidates."""
    dtype: DType = "float64"


def diagonals_of(kind: str) -> tuple[float, ...]:
    """Sizes of a kind of bodies in metres."""
    return (SMALLEST_BOX, *DIAGONALS) if kind == "box" else DIAGONALS


@dataclass(frozen=True)
class Task:
    """Queries of bodies of one kind and size."""

    kind: Kind
    """Kind of bodies."""
    diagonal: float
    """Diagonal of the bounding box of the larger body in metres."""
    states: tuple[State, ...]
    """Relative states of the bodies; states that are impossible for such bodies are left out."""
    forwards: tuple[Forward, ...] = ()
    """Ways to query distances and points."""
    derivatives: tuple[Derivative, ...] = ()
    """Ways to differentiate points."""
    translations: tuple[float, ...] = (0.0,)
    """Distances of the bodies from the origin of the world for queries of distances, in metres."""
    queries: int = 64
    """Pairs of poses for each state, way to query and translation."""
    differentiated: int = 16
    """Pairs of poses for each state and derivative."""
    mujoco: int = 8
    """Pairs of poses of each state that MuJoCo is also queried at."""
    seed: int = 0
    """Seed of bodies and poses, which otherwise depend on kind, diagonal and state only."""
