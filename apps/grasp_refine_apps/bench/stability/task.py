"""A piece of the work: bodies of one kind and size, built once, in all their states, asked in all ways."""

from __future__ import annotations

from dataclasses import dataclass

from grasp_refine_apps.bench.stability.cases import Derivative, Forward, Kind, State


@dataclass(frozen=True)
class Task:
    """What is asked of bodies of one kind and size."""

    kind: Kind
    """Which bodies."""
    diagonal: float
    """Diagonal of the bounding box of the larger body in metres."""
    states: tuple[State, ...]
    """How they lie to each other; a state that such bodies cannot be in is left out."""
    forwards: tuple[Forward, ...] = ()
    """How distances and points are asked for."""
    derivatives: tuple[Derivative, ...] = ()
    """How points are differentiated."""
    translations: tuple[float, ...] = (0.0,)
    """How far from the origin of the world the bodies are when distances are asked for, in metres."""
    queries: int = 64
    """Pairs of poses for each state, way of asking and translation."""
    differentiated: int = 16
    """Pairs of poses for each state and derivative."""
    mujoco: int = 8
    """Pairs of poses of each state that MuJoCo is asked too."""
    seed: int = 0
    """Of bodies and poses, which depend on nothing else but kind, diagonal and state."""
