"""The stopwatch of alignment tasks: CPU time by stage, and of the forward and backward passes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields

import numpy as np

from grasp_refine.core import profiling
from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.neighborhood import Neighborhood, Neighbors
from grasp_refine.witness.rings import Neighbor
from grasp_refine.witness.scene import Sides, WitnessScene
from grasp_refine_apps.bench.timing import split_stages

PARTS = split_stages("broad phase", "narrow phase", "derivative")
"""Parts of the CPU time that are measured separately. Broad phase: all of a query but its narrow phase."""

PASSES = ("forward", "backward", "sampling")
"""From poses to losses; from losses to the gradients of poses; and the part of it that chooses surface samples."""


@dataclass
class Stopwatch(profiling.Stopwatch):
    """Seconds by stage, and CPU seconds by pass, while it runs."""

    passes_s: dict[str, float] = field(default_factory=lambda: dict.fromkeys(PASSES, 0.0))
    """Pass -> CPU seconds, over all stages."""

    @contextmanager
    def lap(self, name: str) -> Iterator[None]:
        """Count the time of the block for the pass `name`."""
        start = time.process_time()
        yield
        if self.running:
            self.passes_s[name] += time.process_time() - start


@dataclass(frozen=True)
class TimedDerivative:
    """A derivative method that measures the time of choosing samples."""

    method: Derivative
    watch: Stopwatch

    def pull_back(
        self, scene: WitnessScene, force_a: np.ndarray, force_b: np.ndarray, force_n: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Delegate to the method."""
        parts = {part.name: getattr(scene, part.name) for part in fields(scene)}
        return self.method.pull_back(_TimedScene(**parts, watch=self.watch), force_a, force_b, force_n)


@dataclass(frozen=True, eq=False)
class _TimedScene(WitnessScene):
    """A scene that measures the time of choosing samples."""

    watch: Stopwatch

    def neighbors(self, rule: Neighborhood | Neighbor, seed: int) -> tuple[Sides, Neighbors]:
        """Delegate to the scene."""
        with self.watch.lap("sampling"):
            return super().neighbors(rule, seed)
