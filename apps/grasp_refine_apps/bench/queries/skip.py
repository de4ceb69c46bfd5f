"""Savings of a skip, as a value, and functions shared by the modules on skips."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from grasp_refine.core.profiling import cpu_seconds
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import Refinement, refine
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine_apps.bench.queries.poses import nearby

WARM_UP_ITERATIONS = 2
"""Iterations, of one grasp, before the first measurement."""

PALM_DEVIATIONS = (0.005, 0.05)
"""Standard deviations of the palms of disturbed grasps, in metres and radians; the latter of their joints, too."""


@dataclass(frozen=True, eq=False)
class Example:
    """Grasps of a hand on an object."""

    hand: str
    """Name of the hand."""
    object: str
    """Name of the object."""
    scene: Scene
    config: Config = field(default_factory=Config)
    """Settings of a refinement; by default those of a user."""

    @cached_property
    def prepared(self) -> HandObject:
        """Hand and object, prepared once."""
        return HandObject.of(self.scene)

    @property
    def name(self) -> str:
        """Names of hand and object."""
        return f"{self.hand}, {self.object}"

    def refined(self) -> Refinement:
        """Refine the grasps."""
        return refine(self.scene, self.config, prepared=self.prepared)

    def warm_up(self) -> None:
        """Refine one grasp for a few iterations, so that all caches exist."""
        scene = replace(self.scene, T_world_root=self.scene.T_world_root[:1], q=self.scene.q[:1])
        short = replace(self.config, starts=1, solver=replace(self.config.solver, iterations=WARM_UP_ITERATIONS))
        refine(scene, short, prepared=self.prepared)


def several(scene: Scene, count: int, seed: int) -> Scene:
    """Return `count` grasps: those of the scene, then copies of them, each disturbed at random."""
    own = len(scene.q)
    rows = np.arange(count) % own
    T, q = scene.T_world_root[rows], scene.q[rows]
    again = np.arange(count) >= own
    noise = PALM_DEVIATIONS[1] * np.random.default_rng(seed).normal(size=q.shape)
    T = np.where(again[:, None, None], nearby(T, seed, PALM_DEVIATIONS), T)
    return replace(
        scene, T_world_root=T, q=np.clip(np.where(again[:, None], q + noise, q), scene.hand.lower, scene.hand.upper)
    )


@dataclass(frozen=True)
class Skip:
    """A piece of work that is skipped, and its cost."""

    skip: str
    """The skipped work."""
    unit: str
    """The counted unit."""
    scene: str
    """Hand, object or command of the measurement."""
    without: int
    """Count without the skip."""
    with_: int
    """Count with the skip."""
    cpu_without_s: float | None
    """CPU seconds without the skip; None: not measured separately."""
    cpu_with_s: float | None
    """CPU seconds with the skip."""
    how: str
    """Method that undoes the skip."""
    difference: float | None = None
    """Largest difference of refined poses and joint values without it, in metres and radians; None: no refinement."""

    def row(self) -> dict[str, Any]:
        """Return the flat entry of a table."""
        both = (self.cpu_without_s, self.cpu_with_s)
        saved = None if both[0] is None or both[1] is None else both[0] - both[1]
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
            "cpu_saved_s": saved,
            "difference": self.difference,
            "how": self.how,
        }


@contextmanager
def replace_attribute(owner: Any, name: str, value: Any) -> Iterator[None]:
    """Replace an attribute of a module or class temporarily: the program has no switch that undoes a skip."""
    before = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, before)


def measure_calls(runs: Mapping[str, Callable[[], Any]], rounds: int = 1) -> dict[str, tuple[Any, float]]:
    """Return results of calls and their CPU seconds: of all threads, and of child processes that end in them.

    Args:
        runs: Name -> call: once each at first, unless there is one round, then alternately.
        rounds: Number of measurements of each; the least counts, as the work is the same.
    """
    results = {name: run() for name, run in runs.items()} if rounds > 1 else {}
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(rounds):
        for name, run in runs.items():
            start = cpu_seconds()
            results[name] = run()
            times[name].append(cpu_seconds() - start)
    return {name: (results[name], min(times[name])) for name in runs}
