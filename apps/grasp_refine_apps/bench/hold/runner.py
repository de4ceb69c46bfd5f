"""Runs of every method on grasps on one object, with measures and simulation of the results."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.refinement.refine import refine
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.validation.geometry import Movement, movement
from grasp_refine.validation.hand_model import HandModel
from grasp_refine.validation.motion import Motion, closing
from grasp_refine.validation.protocol import SETTINGS, SettingName
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.world import World, build_world
from grasp_refine_apps.bench.hold.measures import Measures, measure_grasps
from grasp_refine_apps.bench.hold.methods import Method
from grasp_refine_apps.bench.timing import one_thread

WARM_UP_ITERATIONS = 2
"""Iterations, and number of grasps, of the run before the first measurement."""


@dataclass(frozen=True, eq=False)
class Group:
    """N grasps on one object at one scale."""

    object: str
    """Name of the object."""
    scene: Scene
    """Hand, object and the grasps, without targets."""
    came: Motion | None
    """Given motion of the hand as it closes; None: not specified, so that it is computed."""


@dataclass(frozen=True, eq=False)
class GroupResult:
    """Results of N grasps by one method; costs are NaN where there are none."""

    method: Method
    object: str
    measures: Measures
    moved: Movement
    """Distances that the method moved them."""
    cpu_s: np.ndarray
    """CPU seconds of refining each (N,)."""
    wall_s: np.ndarray
    """Wall seconds of refining each (N,)."""
    stages_cpu_s: np.ndarray
    """CPU seconds of finding pregrasp and squeeze of each (N,)."""
    starts: np.ndarray
    """Number of starts of each (N,)."""
    reason: Mapping[str, np.ndarray]
    """Setting -> a `Reason` for each (N,), of the first push that failed."""


@dataclass(frozen=True, eq=False)
class GroupJob:
    """All methods on the grasps of one group."""

    group: Group
    model: HandModel
    """The hand for simulation."""
    methods: tuple[Method, ...]
    settings: tuple[SettingName, ...]
    """Names of the simulation settings."""
    width: int
    """Largest number of grasps that are refined at once."""
    seed: int
    threads: int | None
    """CPU threads of the simulation; None: all cores."""

    @property
    def work(self) -> float:
        """Approximate duration: mostly simulation, which takes about the same for every grasp."""
        return float(len(self.group.scene.q))

    @property
    def label(self) -> str:
        """Label of the job, for a progress bar."""
        return self.group.object

    def do(self, progress: Callable[[float], None]) -> tuple[GroupResult, ...]:
        """Run each method, in this process."""
        with one_thread():
            return self._parts(progress)

    def _parts(self, progress: Callable[[float], None]) -> tuple[GroupResult, ...]:
        scene = self.group.scene
        worlds: dict[str, World] = {
            name: build_world(self.model, scene.object, SETTINGS[name], scene.table) for name in self.settings
        }
        # Caches built once for a hand and an object are not timed.
        prepared = HandObject.of(scene)
        self._warm_up(prepared)
        parts = []
        for number, method in enumerate(self.methods):

            def within(share: float, number: int = number) -> None:
                progress((number + share) / len(self.methods))

            parts.append(self._part(method, prepared, worlds, within))
        return tuple(parts)

    def _warm_up(self, prepared: HandObject) -> None:
        scene = self.group.scene
        few = replace(scene, T_world_root=scene.T_world_root[:WARM_UP_ITERATIONS], q=scene.q[:WARM_UP_ITERATIONS])
        for config in (method.config(self.seed, self.width) for method in self.methods):
            if config is not None:
                short = replace(config, starts=1, solver=replace(config.solver, iterations=WARM_UP_ITERATIONS))
                refine(few, short, prepared=prepared)
        closing(few, prepared)

    def _part(
        self, method: Method, prepared: HandObject, worlds: Mapping[str, World], progress: Callable[[float], None]
    ) -> GroupResult:
        group, scene = self.group, self.group.scene
        count, touching = len(scene.q), None
        cpu_s, wall_s, stages_cpu_s, starts = np.full((4, count), np.nan)
        config = method.config(self.seed, self.width)
        if config is not None:
            found = refine(scene, config, prepared=prepared)
            scene, touching = replace(scene, T_world_root=found.T_world_root, q=found.q), found.touching
            cpu_s, wall_s, starts = found.cpu_s, found.wall_s, found.starts
        if method.name == "as-came" and group.came is not None:
            motion = group.came
        else:
            cpu = time.process_time()
            motion = closing(scene, prepared)
            stages_cpu_s = np.full(count, (time.process_time() - cpu) / max(count, 1))
        reason = {}
        for number, (name, world) in enumerate(worlds.items()):

            def tell(done: float, number: int = number) -> None:
                progress((number + done / count) / len(worlds))

            trials = simulate(world, motion, threads=self.threads, first_failure=True, progress=tell)
            reason[name] = trials.reason[np.arange(count), trials.worst]
        return GroupResult(
            method=method,
            object=group.object,
            measures=measure_grasps(prepared, scene.T_world_root, scene.q, touching),
            moved=movement(group.scene.T_world_root, group.scene.q, scene.T_world_root, scene.q),
            cpu_s=cpu_s,
            wall_s=wall_s,
            stages_cpu_s=stages_cpu_s,
            starts=starts,
            reason=reason,
        )
