"""A shard, the unit of a batch: some grasps of one hand on one object, which become one result file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

Sign = tuple[str, float, int]
"""A sign of life while a shard is worked on: what is being done, the share (0 to 1) of the shard that is done, and how
many of its grasps are refined."""


@runtime_checkable
class Heartbeat(Protocol):
    """Takes a sign of life."""

    def __call__(self, what: str, share: float, refined: int = 0) -> None:
        """Tell what a `Sign` holds."""
        ...


Reason = Literal["error", "crashed", "hung"]
"""Why a shard failed: its work raised, or its worker ended, or gave no sign of life."""


@dataclass(frozen=True)
class Shard:
    """Some grasps of one hand on one object; what comes out depends on nothing else."""

    number: int
    """Its place among all shards of the batch."""
    group: str
    """Shards of one group need the same hand and object, which are loaded once."""
    name: str
    """What people call it: job, object and which grasps."""
    size: int
    """Number of grasps."""
    path: Path
    """Its result file."""
    stamp: str
    """Hash of everything that the result depends on: contents of all inputs, rows, settings and versions."""
    task: Any
    """What the work function needs to know; can be pickled."""


@dataclass(frozen=True)
class Done:
    """What is told about a finished shard."""

    number: int
    """That of the shard."""
    grasps: int
    """How many grasps are in its result file."""
    usable: int
    """How many of them were refined at all."""
    good: tuple[int, int]
    """How many should hold, before and after."""
    held: tuple[int, int] | None
    """How many held in simulation, before and after; None: not simulated."""
    wall_s: float
    """Wall time of the work."""
    cpu_s: float
    """CPU time of the work."""
    peak_bytes: int
    """Largest resident memory of the process so far."""
    notes: tuple[str, ...] = ()
    """What a user should know about how hand, object and grasps were read."""
    convention_notes: tuple[str, ...] = ()
    """Signs that the grasp file means something else than what was read; what is before the colon says what."""
    profile: Mapping[str, tuple[float, float, int]] = field(default_factory=dict)
    """Stage -> CPU seconds, wall seconds and calls; empty where nobody asked."""


@dataclass(frozen=True)
class Failed:
    """What is told about a shard that did not come out."""

    number: int
    """That of the shard."""
    reason: Reason
    """Why."""
    message: str
    """One line for people: what went wrong."""
    traceback: str
    """Where, as Python or the operating system tells it."""
    tries: int
    """How often it was tried."""


Work = Callable[[Shard, Heartbeat], Done]
"""What makes a shard's result file; can be pickled."""
