"""Robustness of grasps: other friction, another pose of the object, no squeeze."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import radians

import numpy as np
from jaxtyping import Bool, Float, Int

from grasp_refine.core.se3 import exp_so3
from grasp_refine.validation.motion import STAGES, Motion
from grasp_refine.validation.simulation import simulate
from grasp_refine.validation.stepping import Conditions
from grasp_refine.validation.world import World

Progress = Callable[[float], None]
"""Called with the number of finished trials, in fractions."""


@dataclass(frozen=True)
class Noise:
    """Random offsets of the object before the hand closes on it."""

    count: int = 0
    """Number of offsets per grasp."""
    offset: float = 0.005
    """Largest shift in metres; shifts are uniform in the sphere of this radius, or its projection on the table."""
    turn: float = radians(5)
    """Largest rotation about the object's middle, in radians; rotation vectors are uniform in the sphere."""


def noise_score(
    world: World,
    motion: Motion,
    noise: Noise,
    *,
    middle: Float[np.ndarray, " 3"],
    numbers: Int[np.ndarray, " N"],
    upright: Float[np.ndarray, " 3"] | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Float[np.ndarray, " N"]:
    """Return the share (N,) of the offsets of the object at which a grasp still holds in every direction.

    Args:
        world: Hand, object and protocol.
        motion: N grasps.
        noise: The offsets.
        middle: Centre of the rotations (3,), metres, object frame.
        numbers: Number (N,) of each grasp: its offsets depend on this and on the seed only.
        upright: Unit normal (3,) of the table, where there is one: objects then stay on it, shifted and turned.
        seed: Seed of the offsets.
        threads: CPU threads.
        progress: Called with finished trials, of N x `noise.count`.
    """
    each = np.repeat(np.arange(len(motion)), noise.count)
    shifts, turns = zip(
        *(_draw(np.random.default_rng([seed, int(number)]), noise) for number in numbers),
        strict=True,
    )
    shift, turn = np.concatenate(shifts), np.concatenate(turns)
    if upright is not None:
        shift, turn = shift - np.outer(shift @ upright, upright), np.outer(turn @ upright, upright)
    T = np.tile(np.eye(4), (len(each), 1, 1))
    T[:, :3, :3] = exp_so3(turn)
    T[:, :3, 3] = middle - T[:, :3, :3] @ middle + shift
    friction = np.full(len(each), world.protocol.friction)
    trials = simulate(
        world, motion.select(each), Conditions(T, friction), threads=threads, first_failure=True, progress=progress
    )
    return trials.success.reshape(len(motion), noise.count).mean(axis=1)


def holds_at(
    world: World,
    motion: Motion,
    frictions: Sequence[float],
    *,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Bool[np.ndarray, "N F"]:
    """Return True (N, F) where a grasp holds with a coefficient of sliding friction."""
    each, at = np.repeat(np.arange(len(motion)), len(frictions)), np.tile(frictions, len(motion))
    conditions = replace(Conditions.nominal(world, len(each)), friction=at.astype(float))
    trials = simulate(world, motion.select(each), conditions, threads=threads, first_failure=True, progress=progress)
    return trials.success.reshape(len(motion), len(frictions))


def holds_without_squeeze(
    world: World, motion: Motion, *, threads: int | None = None, progress: Progress | None = None
) -> Bool[np.ndarray, " N"]:
    """Return True (N,) where a grasp holds when the hand stops closing at the grasp."""
    grasp, squeeze = STAGES.index("grasp"), STAGES.index("squeeze")
    T, q = motion.T_world_root.copy(), motion.q.copy()
    T[:, squeeze], q[:, squeeze] = T[:, grasp], q[:, grasp]
    return simulate(world, Motion(T, q), threads=threads, first_failure=True, progress=progress).success


def _draw(rng: np.random.Generator, noise: Noise) -> tuple[np.ndarray, np.ndarray]:
    """Return shifts and rotation vectors (count, 3) each, uniform in spheres."""
    samples = []
    for radius in (noise.offset, noise.turn):
        direction = rng.normal(size=(noise.count, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        samples.append(radius * rng.uniform(size=(noise.count, 1)) ** (1 / 3) * direction)
    return samples[0], samples[1]
