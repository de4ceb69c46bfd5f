"""Every method on the same grasps of one object: refinement with its cost, measures, and simulation of the results."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from grasp_refine.closing.motion import Motion, closing_motion
from grasp_refine.core.plurals import count_text
from grasp_refine.forces.squeeze import CONTACTS
from grasp_refine.measures.geometry import measure, movement
from grasp_refine.measures.metrics import metrics
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.refine import refine
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.scene import Scene
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.hand_model import HandModel
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.robustness import judge
from grasp_refine_apps.bench.jobs import Progress, part_of
from grasp_refine_apps.bench.timing import one_thread, warmed_up

MethodName = Literal["as-came", "own-stages", "geometry-only", "forces"]
"""Names of the methods in rows."""

LABELS = {"as-came": "input grasps", "own-stages": "own stages", "geometry-only": "geometry only"}
"""Name of a method -> its label for people; of refinement with forces, the number of starts."""


@dataclass(frozen=True)
class Method:
    """A method applied to grasps; all but "as-came" end with a pregrasp and a squeeze of our own."""

    name: MethodName
    """Name in rows."""
    starts: int | None = None
    """Number of starts of a grasp that may not hold; None: it is not moved."""

    @property
    def label(self) -> str:
        """Label for people."""
        return LABELS.get(self.name, count_text(self.starts or 0, "start"))

    def config(self, seed: int, width: int) -> Config | None:
        """Settings of the refinement; None where there is none."""
        if self.starts is None:
            return None
        weights = Weights() if self.name == "forces" else replace(Weights(), wrench=0.0)
        return Config(weights=weights, starts=self.starts, seed=seed, width=width)


def methods(starts: tuple[int, ...], *, stages: bool) -> tuple[Method, ...]:
    """Return all methods to compare: the references, and refinement from each of the numbers of starts.

    Args:
        starts: Numbers of starts.
        stages: Whether the input grasps have pregrasps or squeezes, to be compared with ours.
    """
    own = (Method("own-stages"),) if stages else ()
    references = (Method("as-came"), *own, Method("geometry-only", 1))
    return (*references, *(Method("forces", count) for count in dict.fromkeys(starts)))


@dataclass(frozen=True, eq=False)
class GroupResult:
    """Results of N grasps by one method."""

    method: Method
    object: str
    values: Mapping[str, np.ndarray]
    """Number -> its value for each grasp (N,), NaN where there is none: cpu_ms and wall_ms of refinement,
    stages_cpu_ms of finding pregrasp and squeeze, starts, moved_palm_m, moved_palm_rad and moved_joints_rad,
    contact_gap_m of the worst link that touches, and fields of `Metrics`."""
    reason: Mapping[str, np.ndarray]
    """Protocol -> a `Reason` for each (N,), of the first push that failed."""


@dataclass(frozen=True, eq=False)
class GroupTask:
    """All methods on N grasps on one object at one scale."""

    object: str
    """Name of the object."""
    scene: Scene
    """Hand, object and the grasps, without targets."""
    motion: Motion | None
    """Given motion of the hand as it closes; None: not specified, so that it is computed."""
    model: HandModel
    """The hand for simulation."""
    methods: tuple[Method, ...]
    protocols: Mapping[str, Protocol]
    """Protocols of the simulation by the name in results."""
    width: int
    """Largest number of grasps that are refined at once."""
    seed: int
    threads: int | None
    """CPU threads of the simulation; None: all cores."""

    def run(self, progress: Progress) -> list[GroupResult]:
        """Apply each method, in this process."""
        with one_thread():
            scene = self.scene
            worlds: dict[str, World] = {
                name: build_world(self.model, scene.object, Task(protocol).over(scene.task))
                for name, protocol in self.protocols.items()
            }
            # Caches built once for a hand and an object are not timed.
            configs = (method.config(self.seed, self.width) for method in self.methods)
            prepared = warmed_up(scene, [config for config in configs if config is not None])
            closing_motion(scene.select(slice(1)), prepared)
            share = 1.0 / len(self.methods)
            return [
                self._result(method, prepared, worlds, part_of(progress, number * share, share))
                for number, method in enumerate(self.methods)
            ]

    def _result(
        self, method: Method, prepared: HandObject, worlds: Mapping[str, World], progress: Progress
    ) -> GroupResult:
        before = scene = self.scene
        count, touching = len(scene.q), None
        cost = dict(zip(("cpu_ms", "wall_ms", "stages_cpu_ms", "starts"), np.full((4, count), np.nan), strict=True))
        moved = dict(zip(("palm_m", "palm_rad", "joints_rad", "slides_m"), np.full((4, count), np.nan), strict=True))
        config = method.config(self.seed, self.width)
        if config is not None:
            found = refine(scene, config, prepared=prepared)
            scene, touching = replace(scene, T_world_root=found.T_world_root, q=found.q), found.touching
            cost |= {"cpu_ms": 1e3 * found.cpu_s, "wall_ms": 1e3 * found.wall_s, "starts": found.starts.astype(float)}
            moved = vars(movement(before.T_world_root, before.q, scene.T_world_root, scene.q, scene.hand.slides))
        if method.name == "as-came" and self.motion is not None:
            motion = self.motion
        else:
            cpu = time.process_time()
            motion = closing_motion(scene, prepared)
            cost["stages_cpu_ms"] = np.full(count, 1e3 * (time.process_time() - cpu) / max(count, 1))
        reason = {}
        for number, (name, world) in enumerate(worlds.items()):
            within = part_of(progress, number / len(worlds), 1.0 / (len(worlds) * max(count, 1)))
            trials = judge(world, motion, threads=self.threads, first_failure=True, progress=within)
            reason[name] = trials.outcome
        values = metrics(scene.hand, scene.object, scene.T_world_root, scene.q).values
        gap = {"contact_gap_m": contact_gap(scene, touching)}
        return GroupResult(
            method,
            self.object,
            {**cost, **values, **gap, **{f"moved_{name}": its for name, its in moved.items()}},
            reason,
        )


def contact_gap(scene: Scene, touching: np.ndarray | None = None) -> np.ndarray:
    """Return the largest distance (N,) in metres to the object's surface, in or out, of the links that touch.

    NaN without any, and where a query failed.

    Args:
        scene: The grasps.
        touching: Links (N, L) that touch; None: those that are near, as for forces.
    """
    nothing = np.full((len(scene.q), len(scene.links), 3), np.nan)
    found = measure(scene.hand, scene.object, scene.links, scene.T_world_root, scene.q, nothing, nothing)
    touching = CONTACTS.choose(scene.hand, scene.links, found.witness) if touching is None else touching
    gap = np.where(touching, np.abs(found.distance), -np.inf).max(axis=1)
    return np.where(np.isfinite(gap) & np.isfinite(found.distance).all(axis=1), gap, np.nan)
