"""Validation: everything that is measured of grasps, by geometry and in simulation."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from grasp_refine.core.arguments import as_numbers, check_kind
from grasp_refine.core.array_records import take
from grasp_refine.core.short_repr import brief
from grasp_refine.forces.wrench import center_of_mass
from grasp_refine.hands.hand import Hand
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.scene import Scene
from grasp_refine.validation.hand_model import HandModel
from grasp_refine.validation.metrics import Metrics, metrics
from grasp_refine.validation.mjcf_model import mjcf_model
from grasp_refine.validation.motion import Motion
from grasp_refine.validation.protocol import Protocol
from grasp_refine.validation.robustness import Noise, holds_at, holds_without_squeeze, noise_score
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.trials import Trials
from grasp_refine.validation.urdf_model import urdf_model
from grasp_refine.validation.world import World

BARELY = 0.5
"""A grasp that held is flagged when the object came this share of the way to what counts as lost."""

ENOUGH = 2
"""A grasp that held is flagged when fewer links than this are near the object at the grasp."""

Tell = Callable[[str, float], None]
"""Is told what is being simulated, and how many grasps are done, in fractions."""


@dataclass(frozen=True)
class Checks:
    """What is tried in simulation beside the protocol."""

    noise: Noise = field(default_factory=Noise)
    """Random offsets of the object; by default none."""
    frictions: tuple[float, ...] = ()
    """Coefficients of sliding friction that are tried beside that of the protocol."""
    without_squeeze: bool = False
    """Whether it is tried if grasps hold without their squeeze."""
    seed: int = 0
    """Of the offsets."""
    threads: int | None = None
    """CPU threads; by default as many as there are."""


@dataclass(frozen=True, eq=False)
class Validated:
    """N grasps; what was not asked for is None."""

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
    """Share of its CPU time (N,), seconds."""
    metrics: Metrics
    """Measures at the grasp pose."""
    trials: Trials | None = None
    """What simulation came to."""
    noise: Float[np.ndarray, " N"] | None = None
    """Share (N,) of the offsets of the object with which the grasp held."""
    frictions: Bool[np.ndarray, "N F"] | None = None
    """Whether it held with each of F coefficients of friction (N, F)."""
    unsqueezed: Bool[np.ndarray, " N"] | None = None
    """Whether it held without the squeeze (N,)."""

    __repr__ = brief

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.index)

    @property
    def success(self) -> Bool[np.ndarray, " N"]:
        """Which grasps (N,) held; none where there was no simulation."""
        return np.zeros(len(self), dtype=bool) if self.trials is None else self.trials.success

    def barely(self, protocol: Protocol) -> Bool[np.ndarray, " N"]:
        """Which grasps (N,) held, but let the object come more than half of the way to what counts as lost."""
        if self.trials is None:
            return self.success
        moved = self.trials.peak_m.max(axis=1) > BARELY * protocol.farthest
        turned = self.trials.peak_rad.max(axis=1) > BARELY * protocol.steepest
        return self.success & (moved | turned)

    @property
    def by_squeeze(self) -> Bool[np.ndarray, " N"]:
        """Which grasps (N,) held only because of the squeeze.

        Tried, where that was asked for; otherwise those of which fewer than two links are near the object, so that it
        is the squeeze that brings them there.
        """
        if self.unsqueezed is not None:
            return self.success & ~self.unsqueezed
        return self.success & (self.metrics.contact_number < ENOUGH)

    def select(self, rows: np.ndarray) -> Validated:
        """The grasps `rows`, in that order."""
        return take(self, rows)

    @classmethod
    def join(cls, parts: list[Validated]) -> Validated:
        """The grasps of all parts, of which all were asked for the same."""
        return cls(*(_joined([getattr(part, field.name) for part in parts]) for field in fields(cls)))


def model_of(hand: Hand) -> HandModel:
    """The hand for MuJoCo: from its MJCF where that is what counts, else from its URDF.

    Raises:
        HandError: the MJCF cannot be used, or is of another hand.
        GraspRefineError: no hand.
    """
    check_kind("hand", hand, Hand)
    if hand.collision == "mjcf" and hand.mjcf is not None:
        return mjcf_model(hand, hand.mjcf)
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
    tell: Tell = lambda what, done: None,
) -> Validated:
    """What N grasps on one object are worth: their measures and, with a world, what became of them in simulation.

    Args:
        scene: Hand, object and grasps.
        name: What the object is called.
        scale: Its scale.
        rows: Rows of the grasps in their file.
        index: Numbers of the grasps among those of their object.
        world: Hand and object for MuJoCo; None: nothing is simulated.
        motion: How the hand closes to the grasps; needed for simulation.
        checks: What is tried in simulation beside the protocol; by default nothing.
        tell: Is told how far the simulation is.

    Raises:
        GraspRefineError: an argument of another kind or shape.
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
        "metrics": metrics(scene.hand, scene.object, scene.T_world_root, scene.q),
    }
    if world is None or motion is None:
        return Validated(**labels, wall_s=np.full(count, np.nan), cpu_s=np.full(count, np.nan))
    wall, cpu = time.perf_counter(), time.process_time()
    trials = simulate(world, motion, threads=checks.threads, progress=lambda done: tell("simulating", done))
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return Validated(
        **labels,
        wall_s=np.full(count, wall / max(count, 1)),
        cpu_s=np.full(count, cpu / max(count, 1)),
        trials=trials,
        **_further(world, scene, motion, rows, checks, tell),
    )


def _further(
    world: World, scene: Scene, motion: Motion, rows: np.ndarray, checks: Checks, tell: Tell
) -> dict[str, Any]:
    """The further trials that were asked for."""
    found = {}
    if checks.noise.count:
        found["noise"] = noise_score(
            world,
            motion,
            checks.noise,
            middle=center_of_mass(scene.object),
            upright=_normal(scene) if world.protocol.tabletop else None,
            numbers=rows,
            seed=checks.seed,
            threads=checks.threads,
            progress=lambda done: tell("object elsewhere", done / checks.noise.count),
        )
    if checks.frictions:
        found["frictions"] = holds_at(
            world,
            motion,
            checks.frictions,
            threads=checks.threads,
            progress=lambda done: tell("other friction", done / len(checks.frictions)),
        )
    if checks.without_squeeze:
        found["unsqueezed"] = holds_without_squeeze(
            world, motion, threads=checks.threads, progress=lambda done: tell("without squeeze", done)
        )
    return found


def _normal(scene: Scene) -> np.ndarray:
    return np.asarray(Plane.normal if scene.table is None else scene.table.normal)


def _joined(values: list) -> Any:
    """Arrays, measures or trials as one; None where there are none."""
    first = values[0]
    if first is None:
        return None
    return np.concatenate(values) if isinstance(first, np.ndarray) else type(first).join(values)
