"""Results of a solver of alignment tasks, and the errors at its poses by a separate query."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.se3 import transform_points
from grasp_refine_apps.bench.align.bodies import BodyPair
from grasp_refine_apps.bench.align.patch import Patch
from grasp_refine_apps.bench.align.stopwatch import Stopwatch
from grasp_refine_apps.bench.align.tasks import Tasks


@dataclass(frozen=True, eq=False)
class AlignmentResult:
    """Results of P pairs with up to N tasks each; arrays (N, P, ...). Pairs with fewer tasks repeat theirs."""

    error: np.ndarray
    """Smallest |x_a - t_a|^2 + |x_b - t_b|^2 + (d - beta)^2 of all iterates (N, P), in square metres, by plain witness
    points."""
    T_world_a: np.ndarray
    """Poses (N, P, 4, 4) of the first bodies where the error was smallest."""
    T_world_b: np.ndarray
    """Poses (N, P, 4, 4) of the second bodies where the error was smallest."""
    iterations: np.ndarray
    """Steps that were made (N, P); 0 where a task only repeats another one and was not run."""
    watch: Stopwatch
    """CPU time by stage and pass, and narrow-phase queries."""
    cpu_s: float
    """CPU seconds of the loop."""
    wall_s: float
    """Wall seconds of the loop."""


def pad_tasks(tasks: Sequence[Tasks]) -> list[Tasks]:
    """Repeat the tasks of each pair, so that all pairs have the same number."""
    count = max(map(len, tasks))
    return [pair_tasks.take(np.arange(count) % len(pair_tasks)) for pair_tasks in tasks]


def errors_at(
    bodies: Sequence[BodyPair],
    tasks: Sequence[Tasks],
    T_world_a: np.ndarray,
    T_world_b: np.ndarray,
    margin: float,
    patch: Patch | None = None,
) -> np.ndarray:
    """Return errors (N, P) in square metres at given poses, infinite without witness points.

    The query is independent of all solvers.

    Args:
        bodies: P pairs.
        tasks: N tasks of each pair.
        T_world_a: Poses of the first bodies (N, P, 4, 4).
        T_world_b: Poses of the second bodies (N, P, 4, 4).
        margin: The desired distance in metres.
        patch: The patch witness that the errors are measured by; None: plain witness points.
    """
    pairs = Pairs(tuple(pair.a for pair in bodies), tuple(pair.b for pair in bodies))
    target_a, target_b = (
        np.stack([getattr(pair_tasks, name) for pair_tasks in tasks], axis=1) for name in ("target_a", "target_b")
    )
    found = query(pairs, T_world_a, T_world_b)
    if patch is not None:
        found = patch.refine(pairs, T_world_a, T_world_b, found, target_a, target_b)
    misses = (
        found.point_a - transform_points(T_world_a, target_a),
        found.point_b - transform_points(T_world_b, target_b),
    )
    error = sum((miss**2).sum(axis=-1) for miss in misses) + (found.distance - margin) ** 2
    return np.where(found.valid, error, np.inf)
