"""A piece of the work: bodies of one kind and size, built once, in all their states, queried in all ways."""

from __future__ import annotations

from dataclasses import dataclass

from grasp_refine_apps.bench.stability.cases import Derivative, Forward, Kind, State


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
