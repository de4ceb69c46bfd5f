"""Shard, the unit of a batch: some grasps of one hand on one object, which become one result file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Shard:
    """Some grasps of one hand on one object, whose result depends on nothing else."""

    number: int
    """Index among all shards of the batch."""
    group: str
    """Key of the hand and object, which the shards of one group share and load once."""
    name: str
    """Name for people: job, object and part."""
    size: int
    """Number of grasps."""
    path: Path
    """Path of the result file."""
    stamp: str
    """Hash of everything that the result depends on: contents of all inputs, rows, settings and versions."""
    task: Any
    """Input of the work function; can be pickled."""


@dataclass(frozen=True)
class Done:
    """Result of a finished shard."""

    grasps: int
    """Number of grasps in its result file."""
    usable: int
    """Number of grasps that were refined at all."""
    good: tuple[int, int]
    """Numbers of grasps that should hold, before and after."""
    held: tuple[int, int] | None
    """Numbers of grasps that held in simulation, before and after; None: not simulated."""
    wall_s: float
    """Wall time of the work, seconds."""
    cpu_s: float
    """CPU time of the work, seconds."""
    peak_bytes: int
    """Largest resident memory of the process so far, bytes."""
    notes: tuple[str, ...] = ()
    """Notes for the user on how hand, object and grasps were read."""
    convention_notes: tuple[str, ...] = ()
    """Signs that the grasp file has another convention than the one read; the kind of sign is before the colon."""
    profile: Mapping[str, tuple[float, float, int]] = field(default_factory=dict)
    """Stage -> CPU seconds, wall seconds and calls; empty without profiling."""
