"""Ways to try grasps: a protocol in an engine, or the trajectory of a hand on an arm in its scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from grasp_refine.closing.motion import Motion
from grasp_refine.core.short_repr import labels
from grasp_refine.hands.hand import Hand
from grasp_refine.motion.execution import follow
from grasp_refine.motion.plan import plan_motions
from grasp_refine.problem.input_cache import InputCache
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.scene import SCENE
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine.validation.engine_table import ENGINES, MUJOCO, EngineName, engine_of
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.robustness import judge
from grasp_refine.validation.trials import Reason
from grasp_refine.validation.validate import model_of

HELD = Reason.HELD.label
"""Verdict of a grasp that succeeds."""

Found = dict[str, np.ndarray]
"""Name -> entry of each grasp (N,)."""


@dataclass(frozen=True, eq=False)
class Tried:
    """N grasps on one object that are tried."""

    scene: Scene
    """Hand, object and the grasps, with the task that they know of."""
    motion: Motion
    """Motion that closes the hand."""
    task: Task
    """Task and scene of the object in simulation."""

    def world(self, protocol: Protocol, cache: InputCache) -> World:
        """Build the simulated world, or return it from the cache."""
        hand = self.scene.hand
        model = cache.get("model", hand, partial(model_of, hand))
        content = self.scene.object, Task(protocol).over(self.task).for_simulation
        return cache.get("world", (hand, *content), partial(build_world, model, *content))


@dataclass(frozen=True)
class Trial:
    """Simulation of the closing hand by a protocol, in an engine."""

    protocol: Protocol
    engine: EngineName = MUJOCO
    name: str = ""
    """Name in tables; empty: the name of the protocol."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of its verdicts: the protocol, with the engine where it is not MuJoCo."""
        name = self.name or self.protocol.name
        return (name if self.engine == MUJOCO else f"{name} in {ENGINES[self.engine].title}",)

    def run(self, tried: Tried, cache: InputCache, threads: int | None, progress: Callable[[float], None]) -> Found:
        """Return the `Reason` of each grasp in words."""
        world = tried.world(self.protocol, cache)
        engine = cache.get("engine", (self.engine, world), partial(engine_of, self.engine, world))
        count = max(len(tried.motion), 1)
        trials = judge(
            world,
            tried.motion,
            threads=threads,
            first_failure=True,
            progress=lambda done: progress(done / count),
            engine=engine,
        )
        return {self.columns[0]: labels(Reason, trials.outcome)}


@dataclass(frozen=True)
class WholeTrajectory:
    """Trajectory of a hand on an arm, planned and followed in simulation from the approach to the lift."""

    columns: tuple[str, ...] = field(default=("reachable", "trajectory is free", "held and lifted", "and nothing hit"))
    """Names of its verdicts."""

    def run(self, tried: Tried, cache: InputCache, threads: int | None, progress: Callable[[float], None]) -> Found:
        """Return the verdicts, and the largest displacement of a neighbour in metres; NaN where none is free."""
        hand: Hand = tried.scene.hand
        planned = plan_motions(tried.scene, tried.motion)
        found = follow(tried.world(SCENE, cache), hand, planned, threads=threads)
        free = np.array([plan.free for plan in planned], dtype=bool)
        passed = ~tried.scene.out_of_reach, free, found.held, found.held & found.clean
        failed = "out of reach", "trajectory is blocked", "not held", "something is hit"
        pushed = np.where(np.isnan(found.pushed_m), -np.inf, found.pushed_m).max(axis=1, initial=-np.inf)
        return {
            **{name: np.where(ok, HELD, no) for name, ok, no in zip(self.columns, passed, failed, strict=True)},
            "pushed_m": np.where(np.isfinite(pushed), pushed, np.nan),
        }


AnyTrial = Trial | WholeTrajectory
