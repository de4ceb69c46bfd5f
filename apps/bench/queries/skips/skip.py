"""What a skip saves, as a value, and what several of these modules need."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from grasp_refine.config import Config
from grasp_refine.hand_object import HandObject
from grasp_refine.refine import Refinement, refine
from grasp_refine.scene import Scene


@dataclass(frozen=True, eq=False)
class Example:
    """Grasps of a hand on an object."""

    hand: str
    """Name of the hand."""
    object: str
    """Name of the object."""
    scene: Scene
    config: Config = field(default_factory=Config)
    """The settings of a refinement; by default what a user gets."""
    prepared: HandObject = field(init=False)
    """Of both, built once."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "prepared", HandObject.of(self.scene))

    @property
    def name(self) -> str:
        """Both names."""
        return f"{self.hand}, {self.object}"

    def refined(self) -> Refinement:
        """The grasps, refined."""
        return refine(self.scene, self.config, prepared=self.prepared)


@dataclass(frozen=True)
class Skip:
    """A piece of work that is left out, and what it would cost."""

    skip: str
    """What is left out."""
    unit: str
    """What is counted."""
    scene: str
    """Where."""
    without: int
    """Count without the skip."""
    with_: int
    """Count as the program is."""
    cpu_without_s: float | None
    """CPU seconds without it; None: not told apart."""
    cpu_with_s: float | None
    """CPU seconds as the program is."""
    how: str
    """How the numbers without it came about."""
    difference: float | None = None
    """Largest difference of refined poses and joint values without it, in metres and radians; None: none is refined."""

    def row(self) -> dict[str, Any]:
        """The flat entry of a table."""
        timed = self.cpu_without_s is not None and self.cpu_with_s is not None
        return {
            "table": "skips",
            "skip": self.skip,
            "unit": self.unit,
            "scene": self.scene,
            "without": self.without,
            "with": self.with_,
            "saved_share": 1.0 - self.with_ / self.without if self.without else 0.0,
            "cpu_without_s": self.cpu_without_s,
            "cpu_with_s": self.cpu_with_s,
            "cpu_saved_s": self.cpu_without_s - self.cpu_with_s if timed else None,
            "difference": self.difference,
            "how": self.how,
        }


@contextmanager
def replaced(owner: Any, name: str, value: Any) -> Iterator[None]:
    """Another value of an attribute, of a module or class, for a while: no switch in the program undoes a skip."""
    before = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, before)


def timed(runs: Mapping[str, Callable[[], Any]], rounds: int = 1) -> dict[str, tuple[Any, float]]:
    """What calls give, and their CPU seconds: of all threads, and of child processes that end in them.

    Args:
        runs: Name -> what is called: first once each, unless there is one round, then in turn.
        rounds: How often each is measured; medians count.
    """
    results = {name: run() for name, run in runs.items()} if rounds > 1 else {}
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            start = _cpu_seconds()
            results[name] = run()
            times[name].append(_cpu_seconds() - start)
    return {name: (results[name], median(times[name])) for name in runs}


def _cpu_seconds() -> float:
    times = os.times()
    return time.process_time() + times.children_user + times.children_system
