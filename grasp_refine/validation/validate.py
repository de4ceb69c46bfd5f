"""Validation: all measures of grasps, by geometry and in simulation."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

import numpy as np

from grasp_refine.closing.motion import Motion
from grasp_refine.core.arguments import as_numbers, check_kind
from grasp_refine.core.array_records import ArrayRecord
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.short_repr import brief
from grasp_refine.hands.hand import Hand
from grasp_refine.measures.metrics import Metrics, metrics_of
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.noise import Noise
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.scene import Scene
from grasp_refine.validation.creep import creep_of
from grasp_refine.validation.engine_table import ENGINES, MUJOCO, EngineName, engine_of
from grasp_refine.validation.engines.mujoco.hand_model import HandModel
from grasp_refine.validation.engines.mujoco.mjcf_model import mjcf_model
from grasp_refine.validation.engines.mujoco.mounted_model import mounted_model
from grasp_refine.validation.engines.mujoco.urdf_model import urdf_model
from grasp_refine.validation.engines.mujoco.world import World
from grasp_refine.validation.engines.simulations import Engine
from grasp_refine.validation.robustness import holds_at, holds_without_squeeze, judge, noise_score
from grasp_refine.validation.trials import Trials

BARELY = 0.5
"""Share of the limits of a lost object above which a grasp that held is flagged."""

MIN_CONTACT_LINKS = 2
"""Smallest number of links near the object at the grasp; a grasp that held with fewer is flagged."""

Progress = Callable[[str, float], None]
"""Called with the name of the present simulation, and the number of finished grasps, in fractions."""


@dataclass(frozen=True)
class Checks:
    """Further trials in simulation beside the protocol."""

    noise: Noise = field(default_factory=Noise)
    """Random offsets of the object; by default none."""
    frictions: tuple[float, ...] = ()
    """Coefficients of sliding friction beside that of the protocol."""
    without_squeeze: bool = False
    """Whether grasps are also tried without their squeeze."""
    seed: int = 0
    """Seed of the offsets."""
    threads: int | None = None
    """CPU threads; by default as many as there are."""


@dataclass(frozen=True, eq=False)
class Validated(ArrayRecord):
    """Measures of N grasps; None where they were not requested."""

    object: np.ndarray
    """Name of the object (N,)."""
    scale: np.ndarray
    """Factor that takes the object's mesh to metres (N,)."""
    row: np.ndarray
    """Row in the grasp file (N,)."""
    index: np.ndarray
    """Number among the grasps of the object (N,)."""
    wall_s: np.ndarray
    """Share of the wall time of the simulation (N,), seconds."""
    cpu_s: np.ndarray
    """Share of the CPU time of the simulation (N,), seconds."""
    metrics: Metrics
    """Measures at the grasp pose."""
    engines: Mapping[EngineName, Trials] = field(default_factory=dict)
    """Name of each engine -> trials in it; those in the first one decide. Empty: nothing was simulated."""
    mass: Float[np.ndarray, " N"] | None = None
    """Mass of the simulated object (N,), kg."""
    noise: Float[np.ndarray, " N"] | None = None
    """Share (N,) of the offsets of the object with which the grasp held."""
    frictions: Bool[np.ndarray, "N F"] | None = None
    """True (N, F) where the grasp held with a coefficient of friction."""
    unsqueezed: Bool[np.ndarray, " N"] | None = None
    """True (N,) where the grasp held without the squeeze."""
    creep: Float[np.ndarray, "N 2"] | None = None
    """Drift (N, 2) of lost objects by creep in MuJoCo, as of `creep_of`; None: contacts are firm, or not MuJoCo's."""
    closed_m: Float[np.ndarray, " N"] | None = None
    """Distance (N,) by which open fingers were closed first in these trials, metres, as `Motion.closed_m`."""

    __repr__ = brief

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.index)

    @property
    def trials(self) -> Trials | None:
        """Trials in the first engine; None: nothing was simulated."""
        return next(iter(self.engines.values()), None)

    @property
    def success(self) -> Bool[np.ndarray, " N"]:
        """True where a grasp (N,) held; False without simulation."""
        return np.zeros(len(self), dtype=bool) if self.trials is None else self.trials.success

    def barely(self, protocol: Protocol) -> Bool[np.ndarray, " N"]:
        """Return True where a grasp (N,) held, but the object moved more than `BARELY` of the limits of a lost one."""
        if self.trials is None:
            return self.success
        moved = self.trials.most("peak_m") > BARELY * protocol.farthest
        turned = self.trials.most("peak_rad") > BARELY * protocol.steepest
        return self.success & (moved | turned)

    @property
    def by_squeeze(self) -> Bool[np.ndarray, " N"]:
        """True where a grasp (N,) held only because of the squeeze.

        Simulated, where that was requested; otherwise grasps with fewer than two links near the object, so that only
        the squeeze brings them into contact, and which were not closed first.
        """
        if self.unsqueezed is not None:
            return self.success & ~self.unsqueezed
        few = self.success & (self.metrics.contact_number < MIN_CONTACT_LINKS)
        return few if self.closed_m is None else few & ~(self.closed_m > 0.0)

    @property
    def by_creep(self) -> Bool[np.ndarray, " N"]:
        """True where MuJoCo loses a grasp (N,) by the creep of its contacts alone."""
        return np.zeros(len(self), dtype=bool) if self.creep is None else ~np.isnan(self.creep).any(axis=1)

    @classmethod
    def join(cls, parts: Sequence[Validated]) -> Validated:
        """Return the grasps of all parts, which have the same measures."""
        return cls(*(_joined([getattr(part, field.name) for part in parts]) for field in fields(cls)))


def model_of(hand: Hand) -> HandModel:
    """Return the model of the hand for MuJoCo: from its MJCF where that is its collision geometry, else from its URDF.

    Raises:
        HandError: the MJCF cannot be used, or is of another hand.
        GraspRefineError: not a hand.
    """
    check_kind("hand", hand, Hand)
    if hand.collision == "mjcf" and hand.mjcf is not None:
        return mounted_model(hand) if hand.parts else mjcf_model(hand, hand.mjcf)
    return urdf_model(hand)


def validate(
    scene: Scene,
    *,
    name: str,
    scale: float,
    rows: np.ndarray,
    index: np.ndarray,
    world: World | None = None,
    motion: Motion | None = None,
    checks: Checks | None = None,
    engines: Sequence[EngineName] = (MUJOCO,),
    progress: Progress = lambda what, done: None,
) -> Validated:
    """Measure N grasps on one object and, with a world, simulate them.

    Args:
        scene: Hand, object and grasps.
        name: Name of the object.
        scale: Factor that takes the object's mesh to metres.
        rows: Rows of the grasps in their file.
        index: Numbers of the grasps within their object.
        world: Hand and object for MuJoCo; None: nothing is simulated.
        motion: Motion that closes the hand to the grasps; needed for simulation.
        checks: Further trials beside the protocol; by default none.
        engines: Names of the engines that simulate; the first one decides, and makes the further trials.
        progress: Called with the progress of the simulation.

    Raises:
        GraspRefineError: an argument of another type or shape, or an engine that cannot be used.
    """
    check_kind("scene", scene, Scene)
    check_kind("world", world, World | None)
    check_kind("motion", motion, Motion | None)
    check_kind("checks", checks, Checks | None)
    checks = checks or Checks()
    count = len(scene.q)
    rows, index = (as_numbers(name, value, count).astype(int) for name, value in (("rows", rows), ("index", index)))
    labels: dict[str, Any] = {
        "object": np.full(count, name),
        "scale": np.full(count, scale),
        "row": rows,
        "index": index,
        "metrics": metrics_of(scene),
    }
    if world is None or motion is None:
        return Validated(**labels, wall_s=np.full(count, np.nan), cpu_s=np.full(count, np.nan))
    wall, cpu = time.perf_counter(), time.process_time()
    loaded = {name: engine_of(name, world) for name in engines}
    trials = {
        name: judge(
            world,
            motion,
            numbers=rows,
            threads=checks.threads,
            progress=partial(progress, f"simulating in {ENGINES[name].title}"),
            engine=engine,
        )
        for name, engine in loaded.items()
    }
    creep = None
    if MUJOCO in trials:
        drifting = partial(progress, "creep without a push")
        creep = creep_of(world, motion, trials[MUJOCO], threads=checks.threads, progress=drifting)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return Validated(
        **labels,
        wall_s=np.full(count, wall / max(count, 1)),
        cpu_s=np.full(count, cpu / max(count, 1)),
        engines=trials,
        creep=creep,
        mass=np.full(count, world.mass),
        closed_m=motion.closed_m,
        **_further(world, scene, motion, rows, checks, loaded[engines[0]], progress),
    )


def _further(
    world: World,
    scene: Scene,
    motion: Motion,
    rows: np.ndarray,
    checks: Checks,
    engine: Engine,
    progress: Progress,
) -> dict[str, Any]:
    """Return the further trials that were requested."""
    found = {}
    if checks.noise.count:
        found["noise"] = noise_score(
            world,
            motion,
            checks.noise,
            middle=scene.object.center_of_mass,
            upright=_normal(scene) if world.protocol.tabletop else None,
            numbers=rows,
            seed=checks.seed,
            threads=checks.threads,
            progress=lambda done: progress("object elsewhere", done / checks.noise.count),
            engine=engine,
        )
    if checks.frictions:
        found["frictions"] = holds_at(
            world,
            motion,
            checks.frictions,
            numbers=rows,
            threads=checks.threads,
            progress=lambda done: progress("other friction", done / len(checks.frictions)),
            engine=engine,
        )
    if checks.without_squeeze:
        found["unsqueezed"] = holds_without_squeeze(
            world,
            motion,
            numbers=rows,
            threads=checks.threads,
            progress=lambda done: progress("without squeeze", done),
            engine=engine,
        )
    return found


def _normal(scene: Scene) -> np.ndarray:
    if scene.environment is not None:
        return scene.environment.up
    return np.asarray(Plane.normal if scene.table is None else scene.table.normal)


def _joined(values: list) -> Any:
    """Return arrays, measures or trials as one; None where a part has none. Of mappings, the keys of all parts."""
    first = values[0]
    if isinstance(first, Mapping):
        return {key: _joined([value[key] for value in values]) for key in first if all(key in each for each in values)}
    if any(value is None for value in values):
        return None
    return np.concatenate(values) if isinstance(first, np.ndarray) else type(first).join(values)
