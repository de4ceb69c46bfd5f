"""Limits of grasps, by bisection: the lowest friction, and the largest force and torque, at which they hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from grasp_refine.closing.motion import Motion
from grasp_refine.core.array_records import ArrayRecord, join
from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.short_repr import brief
from grasp_refine.scene.protocols.protocol import AXES
from grasp_refine.validation.engines.mujoco.stepping import Conditions
from grasp_refine.validation.engines.mujoco.world import World
from grasp_refine.validation.simulation import CHUNK_GRASPS, close, push, simulate

STEPS = 5
"""Number of bisections; the result lies within the 32nd part of the searched range, in its logarithm."""

FRICTION_RANGE = (1 / 16, 2.0)
"""Searched coefficients of friction: five octaves, so that a result is within 11 %."""

FORCE_RANGE_N = (0.5, 32.0)
"""Searched forces, newtons: six octaves, so that a result is within 14 %."""

TORQUE_RANGE_NM = (0.02, 1.28)
"""Searched torques, newton metres: six octaves, so that a result is within 14 %."""


@dataclass(frozen=True, eq=False)
class Limits(ArrayRecord):
    """Extremes at which N grasps hold, all else as in the protocol; each was tried, and the next step lost it."""

    friction: Float[np.ndarray, " N"]
    """Lowest friction (N,) at which the grasp holds the pushes of the protocol; NaN: it holds at none."""
    force: Float[np.ndarray, " N"]
    """Largest force (N,) along each of the six axes, at the object's centre of mass, newtons; 0: it holds none."""
    torque: Float[np.ndarray, " N"]
    """Largest torque (N,) about each of the six axes, newton metres; 0: it holds none."""

    __repr__ = brief


def limits(
    world: World,
    motion: Motion,
    *,
    threads: int | None = None,
    progress: Callable[[float], None] = lambda done: None,
) -> Limits:
    """Return the limits of N grasps.

    Args:
        world: Hand, object and protocol.
        motion: Motion that closes the hand.
        threads: CPU threads; by default as many as there are.
        progress: Called with the number of finished grasps, in fractions.
    """
    parts = []
    for start in range(0, len(motion), CHUNK_GRASPS):
        chunk = motion.select(np.arange(start, min(start + CHUNK_GRASPS, len(motion))))

        def report(share: float, start: int = start, count: int = len(chunk)) -> None:
            progress(start + share * count)

        parts.append(_of_chunk(world, chunk, threads, report))
    return join(*parts)


def _of_chunk(world: World, motion: Motion, threads: int | None, progress: Callable[[float], None]) -> Limits:
    """Return the limits of a few grasps, which close once for all forces and torques."""
    nominal = Conditions.nominal(world, len(motion))
    closed = close(world, motion, nominal, threads=threads)
    axes = np.array(list(AXES.values()))

    def holds_at(friction: np.ndarray) -> np.ndarray:
        conditions = replace(nominal, friction=friction)
        return simulate(world, motion, conditions, threads=threads, first_failure=True).success

    def holds(first: int, size: np.ndarray) -> np.ndarray:
        wrench = np.zeros((len(size), len(axes), 6))
        wrench[:, :, first : first + 3] = size[:, None, None] * axes
        pushed = replace(closed, conditions=replace(nominal, wrench=wrench))
        return push(world, pushed, threads=threads, first_failure=True).success

    count = len(motion)
    friction = _bisect(holds_at, FRICTION_RANGE[1], FRICTION_RANGE[0], count)
    progress(1 / 3)
    force = _bisect(partial(holds, 0), *FORCE_RANGE_N, count)
    progress(2 / 3)
    torque = _bisect(partial(holds, 3), *TORQUE_RANGE_NM, count)
    progress(1.0)
    return Limits(friction, np.nan_to_num(force), np.nan_to_num(torque))


def _bisect(
    holds: Callable[[np.ndarray], Bool[np.ndarray, " N"]], held: float, lost: float, count: int
) -> Float[np.ndarray, " N"]:
    """Return the value (N,) nearest to `lost` at which a trial held, of `STEPS` values in turn; NaN: none did.

    Args:
        holds: Trial of N grasps at a value (N,) each.
        held: End of the range at which grasps hold, if anywhere; it is not tried.
        lost: End at which they do not; it is not tried either.
        count: Number N of grasps.
    """
    near, far, best = (np.full(count, value) for value in (held, lost, np.nan))
    for _ in range(STEPS):
        middle = np.sqrt(near * far)
        success = holds(middle)
        near, far = np.where(success, middle, near), np.where(success, far, middle)
        best = np.where(success, middle, best)
    return best
