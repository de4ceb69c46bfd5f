"""Margins of grasps: each grasp again in worlds that are drawn, with all factors at once and with each alone."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.closing.motion import Motion
from grasp_refine.core.arguments import check_kind
from grasp_refine.core.array_records import ArrayRecord, join
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.plurals import count_text
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.object import Object
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.hand_model import HandModel
from grasp_refine.validation.engines.mujoco.mjcf_model import mjcf_model
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.urdf_model import urdf_model
from grasp_refine.validation.engines.mujoco.world import World, build_world
from grasp_refine.validation.margins.draws import Draws
from grasp_refine.validation.margins.factors import FIELDS, JOINT, PUSH
from grasp_refine.validation.margins.intervals import mean_interval, wilson
from grasp_refine.validation.margins.limits import Limits, limits
from grasp_refine.validation.simulation import simulate

Progress = Callable[[str, float], None]
"""Called with the name of the present simulation, and the number of finished grasps, in fractions."""

ALONE_SHARE = 4
"""Draws of each factor alone are the first of all, one of so many: they cover one range instead of all."""

NO_FACTOR = ""
"""Name of the worst factor of a grasp that every factor alone leaves as it is."""


@dataclass(frozen=True, eq=False)
class Worlds:
    """Worlds of one object, and what the draws need to know of it."""

    usual: World
    """Hand, object and protocol, the palm held rigidly: forces are drawn that a soft weld would give way to."""
    other: World | None
    """Trials with the hand's other model; None: the hand has none."""
    middle: Float[np.ndarray, " 3"]
    """Centre of mass (3,) of the object, metres."""

    @classmethod
    def of(cls, hand: HandModel, obj: Object, task: Task, other: HandModel | None = None) -> Worlds:
        """Return the worlds of an object.

        Args:
            hand: The hand.
            obj: The object.
            task: Task whose protocol pushes, which holds for everything that is not drawn.
            other: The other model of the hand, see `other_model_of`; None: there is none.

        Raises:
            GraspRefineError: a protocol that lifts, or MuJoCo cannot compile the other model with the object.
        """
        # The hand decides for its other model, too.
        protocol = task.test(patches=hand.patches)
        check_pushes(protocol)
        task = replace(task, protocol=replace(protocol, palm="rigid"))
        both = build_world(hand, obj, task), None if other is None else build_world(other, obj, task)
        return cls(*both, obj.center_of_mass)

    def __repr__(self) -> str:
        return f"Worlds({self.usual!r}{', and with the other model of the hand' if self.other else ''})"

    @property
    def trials(self) -> tuple[str, ...]:
        """Names of the trials: all factors, none but the push, and each alone."""
        return (JOINT, PUSH, *(factor for factor in FIELDS if factor != "model" or self.other is not None))


@dataclass(frozen=True, eq=False)
class Margins(ArrayRecord):
    """Trials of N grasps in draws that are the same for all, and their limits."""

    held: Mapping[str, Bool[np.ndarray, "N K"]]
    """True (N, K) where a grasp held in a draw, for each of F kinds of trials: all factors drawn, the push alone, and
    each factor alone."""
    limits: Limits | None
    """Extremes that the grasps hold at; None: not tried."""
    cpu_s: Float[np.ndarray, " N"]
    """Share of the CPU time (N,), seconds."""

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.cpu_s)

    def __repr__(self) -> str:
        mean, lower, upper = self.mean(self.trials[0])
        grasps, draws = count_text(len(self), "grasp"), count_text(self.draws, "draw")
        return f"Margins({grasps}, {draws}: held with {mean:.3f} [{lower:.3f}, {upper:.3f}])"

    @property
    def trials(self) -> tuple[str, ...]:
        """Names of the F kinds of trials."""
        return tuple(self.held)

    @property
    def draws(self) -> int:
        """Number of draws of the first kind of trials."""
        return self.held[self.trials[0]].shape[1]

    @property
    def probability(self) -> Float[np.ndarray, "N F"]:
        """Share (N, F) of the draws in which a grasp held."""
        return np.stack([held.mean(axis=1) for held in self.held.values()], axis=1)

    @property
    def interval(self) -> Float[np.ndarray, "N F 2"]:
        """Interval (N, F, 2) of 95 % of the probability."""
        pairs = [np.stack(wilson(held.sum(axis=1), held.shape[1]), axis=-1) for held in self.held.values()]
        return np.stack(pairs, axis=1)

    def mean(self, trial: str) -> tuple[float, float, float]:
        """Return the mean probability of these grasps with its interval, see `mean_interval`."""
        return mean_interval(self.held[trial])

    @property
    def worst(self) -> np.ndarray:
        """Name (N,) of the factor that alone costs most: the lowest probability below that of the push alone.

        `PUSH` where that is below 1 and no factor makes it worse, `NO_FACTOR` where it is 1.
        """
        return np.array([self.worst_of(each) for each in self.probability], dtype=str)

    def worst_of(self, probability: Float[np.ndarray, " F"]) -> str:
        """Return the name of the factor of the lowest probability (F,), as in `worst`."""
        alone = {name: value for name, value in zip(self.trials, probability, strict=True) if name != JOINT}
        name = min(alone, key=lambda each: alone[each], default=NO_FACTOR)  # the first of several, which is the push
        return name if name and alone[name] < 1 else NO_FACTOR


def other_model_of(hand: Hand) -> HandModel | None:
    """Return the model that `model_of` does not: of the MJCF, or of the URDF; None for a hand without MJCF.

    Raises:
        HandError: the MJCF cannot be used, or is of another hand.
    """
    if hand.mjcf is None:
        return None
    return urdf_model(hand) if hand.collision == "mjcf" else mjcf_model(hand, hand.mjcf)


def check_pushes(protocol: Protocol) -> None:
    """Refuse a protocol without pushes.

    Raises:
        GraspRefineError: it lifts the object.
    """
    if protocol.tabletop:
        raise GraspRefineError(f"margins push the object, and protocol {protocol.name} lifts it: choose another one")


def margins(
    worlds: Worlds,
    motion: Motion,
    draws: Draws,
    *,
    trials: Sequence[str] | None = None,
    with_limits: bool = True,
    threads: int | None = None,
    progress: Progress = lambda what, done: None,
) -> Margins:
    """Return the margins of N grasps.

    In each trial the hand closes, and then the object is pushed with its weight in one direction for the time of the
    protocol; an object that is lost while the hand closes is lost. A trial depends on the grasp and its draw alone.

    Args:
        worlds: Hand, object and protocol.
        motion: Motion that closes the hand to N grasps.
        draws: K worlds; with one factor alone, and with the push alone, only the first quarter of them is tried.
        trials: Names of the trials, out of `Worlds.trials`; None: all of them.
        with_limits: Whether the limits are searched too, which takes about as long as 50 trials.
        threads: CPU threads; by default as many as there are. The result does not depend on it.
        progress: Called with the progress.

    Raises:
        GraspRefineError: an argument of another type, other trials, or no grasp at all.
    """
    check_kind("worlds", worlds, Worlds)
    check_kind("motion", motion, Motion)
    check_kind("draws", draws, Draws)
    start = time.process_time()
    protocol, count = worlds.usual.protocol, len(motion)
    names = worlds.trials if trials is None else tuple(trials)
    if not names or not set(names) <= set(worlds.trials):
        raise GraspRefineError(f"trials are among {', '.join(worlds.trials)}, got {', '.join(names) or 'none'}")
    first = draws.select(np.arange(-(-len(draws) // ALONE_SHARE)))
    kinds = [draws if name == JOINT else first.only(name, protocol, worlds.usual.mass) for name in names]
    flat = join(*kinds)
    conditions = flat.conditions(protocol, worlds.middle)
    other = flat.other_model & (worlds.other is not None)
    held = np.zeros((count, len(flat)), dtype=bool)
    done = 0.0
    for world, rows in ((worlds.usual, np.flatnonzero(~other)), (worlds.other, np.flatnonzero(other))):
        if world is None or not len(rows):
            continue

        def report(finished: float, done: float = done) -> None:
            progress("drawn worlds", (done + finished) / len(flat))

        held[:, rows] = _held(world, motion, conditions.select(rows), threads, report)
        done += count * len(rows)
    found = None
    if with_limits:
        found = limits(worlds.usual, motion, threads=threads, progress=lambda grasps: progress("limits", grasps))
    cpu = time.process_time() - start
    parts = np.split(held, np.cumsum([len(kind) for kind in kinds])[:-1], axis=1)
    return Margins(dict(zip(names, parts, strict=True)), found, np.full(count, cpu / max(count, 1)))


def _held(
    world: World,
    motion: Motion,
    conditions: Conditions,
    threads: int | None,
    progress: Callable[[float], None],
) -> Bool[np.ndarray, "N M"]:
    """Return True (N, M) where a grasp holds in one of M conditions."""
    count, each = len(motion), len(conditions.friction)
    grasp, world_row = np.repeat(np.arange(count), each), np.tile(np.arange(each), count)
    trials = simulate(world, motion.select(grasp), conditions.select(world_row), threads=threads, progress=progress)
    return trials.success.reshape(count, each)
