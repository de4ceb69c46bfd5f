"""Robustness of grasps: other friction, another pose of the object, no squeeze; and verdicts that ask for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypedDict, Unpack

import numpy as np

from grasp_refine.closing.motion import STAGES, Motion
from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.se3 import matrix_from_quaternion
from grasp_refine.scene.protocols.noise import Noise
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import TABLE, World
from grasp_refine.validation.engines.simulations import Engine
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.trials import Trials

Progress = Callable[[float], None]
"""Called with the number of finished trials, in fractions."""

SEED = 0
"""Seed of the offsets that are part of a protocol: they are the same before and after, and for all generators."""


class How(TypedDict, total=False):
    """Arguments of all trials here, as of `simulate`; progress counts every trial of a grasp."""

    threads: int | None
    progress: Progress | None
    engine: Engine


def judge(
    world: World,
    motion: Motion,
    conditions: Conditions | None = None,
    *,
    numbers: Int[np.ndarray, " N"] | None = None,
    first_failure: bool = False,
    **how: Unpack[How],
) -> Trials:
    """Return the trials of N grasps as by `simulate`, with the verdict of the whole protocol.

    Where the protocol has offsets of the object, grasps are tried with each of them as well: their label is the share
    that holds, and they succeed where that is at least the required one.

    Args:
        world: Hand, object and protocol.
        motion: N grasps.
        conditions: What differs between the grasps; by default that of grasps and protocol.
        numbers: Number (N,) of each grasp, such as its row, on which its offsets depend; by default 0 to N - 1.
        first_failure: As for `simulate`.
        how: Threads, progress and engine; progress is the number of finished grasps, in fractions.
    """
    total, progress = 1 + world.protocol.noise.count, how.get("progress")

    def report(done: float) -> None:
        if progress is not None:
            progress(done / total)

    how["progress"] = report
    trials = simulate(world, motion, conditions, first_failure=first_failure, **how)
    if not world.protocol.noise.count:
        return trials
    how["progress"] = lambda done: report(len(motion) + done)
    label = offset_labels(world, motion, conditions, numbers=numbers, **how)
    return replace(trials, label=label, success=label >= world.protocol.required_label)


def offset_labels(
    world: World,
    motion: Motion,
    conditions: Conditions | None = None,
    *,
    numbers: Int[np.ndarray, " N"] | None = None,
    **how: Unpack[How],
) -> Float[np.ndarray, " N"]:
    """Return the share (N,) of the protocol's offsets of the object at which a grasp holds; arguments as of `judge`.

    Progress is that of all N x `protocol.noise.count` trials.
    """
    return noise_score(
        world,
        motion,
        world.protocol.noise,
        conditions,
        middle=world.model.body_ipos[world.object_body],
        numbers=np.arange(len(motion)) if numbers is None else numbers,
        upright=_normal(world),
        seed=SEED,
        **how,
    )


def noise_score(
    world: World,
    motion: Motion,
    noise: Noise,
    conditions: Conditions | None = None,
    *,
    middle: Float[np.ndarray, " 3"],
    numbers: Int[np.ndarray, " N"],
    upright: Float[np.ndarray, " 3"] | None = None,
    seed: int = 0,
    **how: Unpack[How],
) -> Float[np.ndarray, " N"]:
    """Return the share (N,) of the offsets of the object at which a grasp still holds by the rule for directions.

    Args:
        world: Hand, object and protocol.
        motion: N grasps.
        noise: The offsets.
        conditions: What differs between the grasps, with poses that the offsets are added to; by default as of `judge`.
        middle: Centre of the rotations (3,), metres, object frame.
        numbers: Number (N,) of each grasp: its offsets depend on this and on the seed only.
        upright: Unit normal (3,) of the table, where there is one: objects then stay on it, shifted and turned.
        seed: Seed of the offsets.
        how: Threads, progress and engine; progress is the number of finished trials, of N x `noise.count`.
    """
    each = np.repeat(np.arange(len(motion)), noise.count)
    elsewhere = (Conditions.nominal(world, len(motion)) if conditions is None else conditions).select(each)
    T = noise.poses(numbers, middle=middle, upright=upright, seed=seed).reshape(-1, 4, 4)
    elsewhere = replace(elsewhere, T_world_object=elsewhere.T_world_object @ T)
    trials = simulate(world, motion.select(each), elsewhere, first_failure=True, **how)
    return trials.success.reshape(len(motion), noise.count).mean(axis=1)


def holds_at(
    world: World,
    motion: Motion,
    frictions: Sequence[float],
    *,
    numbers: Int[np.ndarray, " N"] | None = None,
    **how: Unpack[How],
) -> Bool[np.ndarray, "N F"]:
    """Return True (N, F) where a grasp holds with a coefficient of sliding friction; arguments as of `judge`."""
    each, at = np.repeat(np.arange(len(motion)), len(frictions)), np.tile(frictions, len(motion))
    conditions = replace(Conditions.nominal(world, len(each)), friction=at.astype(float))
    numbers = each if numbers is None else numbers[each]
    trials = judge(world, motion.select(each), conditions, numbers=numbers, first_failure=True, **how)
    return trials.success.reshape(len(motion), len(frictions))


def holds_without_squeeze(
    world: World,
    motion: Motion,
    *,
    numbers: Int[np.ndarray, " N"] | None = None,
    **how: Unpack[How],
) -> Bool[np.ndarray, " N"]:
    """Return True (N,) where a grasp holds when the hand stops closing at the grasp; arguments as of `judge`."""
    grasp, squeeze = STAGES.index("grasp"), STAGES.index("squeeze")
    T, q = motion.T_world_root.copy(), motion.q.copy()
    T[:, squeeze], q[:, squeeze] = T[:, grasp], q[:, grasp]
    return judge(world, Motion(T, q), numbers=numbers, first_failure=True, **how).success


def _normal(world: World) -> Float[np.ndarray, " 3"] | None:
    """Return the unit normal (3,) of the table; None without one."""
    if not world.protocol.tabletop:
        return None
    if world.scene:
        return world.up
    return matrix_from_quaternion(world.model.geom(TABLE).quat)[:, 2]
