"""CPU time by stage, taken from outside: the library itself measures nothing."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from grasp_refine.collision.narrowphase import Closest, NarrowPhase
from grasp_refine.collision.query import Pairs
from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.neighborhood import Neighborhood, Neighbors
from grasp_refine.witness.rings import Neighbor
from grasp_refine.witness.scene import Sides, WitnessScene

STAGES = ("broadphase", "narrowphase", "derivative", "solver")
"""Broad phase: all of a query but its narrow phase. Solver: all that is left, such as loss and step."""

PASSES = ("forward", "backward", "sampling")
"""From poses to losses; from losses to the gradients of poses; and the part of it that chooses surface samples."""


@dataclass
class Stopwatch:
    """CPU seconds of stages that may lie inside each other; the time of an inner one counts there only."""

    cpu_s: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))
    """Stage -> CPU seconds of this process."""
    passes_s: dict[str, float] = field(default_factory=lambda: dict.fromkeys(PASSES, 0.0))
    """Pass -> CPU seconds, whatever its stages."""
    asked: int = 0
    """Narrow-phase queries."""
    running: bool = False
    """Whether anything is counted."""
    _inner: list[float] = field(default_factory=list)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count what happens inside for the stage `name`."""
        if not self.running:
            yield
            return
        self._inner.append(0.0)
        start = time.process_time()
        try:
            yield
        finally:
            spent = time.process_time() - start
            self.cpu_s[name] += spent - self._inner.pop()
            if self._inner:
                self._inner[-1] += spent

    @contextmanager
    def lap(self, name: str) -> Iterator[None]:
        """Count what happens inside for the pass `name`."""
        start = time.process_time()
        yield
        if self.running:
            self.passes_s[name] += time.process_time() - start


@dataclass(frozen=True)
class TimedDerivative:
    """A derivative method whose time is measured; what it asks of the narrow phase counts there."""

    method: Derivative
    watch: Stopwatch

    def pull_back(
        self, scene: WitnessScene, force_a: np.ndarray, force_b: np.ndarray, force_n: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """What the method says."""
        parts = {part.name: getattr(scene, part.name) for part in fields(scene)}
        with self.watch.stage("derivative"):
            return self.method.pull_back(_TimedScene(**parts, watch=self.watch), force_a, force_b, force_n)


@dataclass(frozen=True, eq=False)
class _TimedScene(WitnessScene):
    """A scene that tells how long it takes to choose samples."""

    watch: Stopwatch

    def neighbors(self, rule: Neighborhood | Neighbor, seed: int) -> tuple[Sides, Neighbors]:
        """What the scene says."""
        with self.watch.lap("sampling"):
            return super().neighbors(rule, seed)


class _TimedNarrowPhase(NarrowPhase):
    """A narrow phase whose time and queries are counted."""

    def __init__(self, pairs: Pairs, watch: Stopwatch) -> None:
        super().__init__(*pairs.piece_pairs, pairs.tolerances)
        self._watch = watch

    def closest(self, *arguments: Any) -> Closest:
        """What the narrow phase says."""
        with self._watch.stage("narrowphase"):
            found = super().closest(*arguments)
        if self._watch.running:
            self._watch.asked += int(found.asked.sum())
        return found


def timed_pairs(pairs: Pairs, watch: Stopwatch) -> Pairs:
    """The same pairs, with a narrow phase that is measured."""
    timed = Pairs(pairs.a, pairs.b, pairs.tolerances)
    # Takes the place of the cached property, which so is never built.
    timed.__dict__["narrow_phase"] = _TimedNarrowPhase(timed, watch)
    return timed
