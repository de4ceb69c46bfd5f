"""Records of every method on one task alone, with the poses of the bodies at each iterate."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from grasp_refine_apps.bench.align.aligned import errors_at
from grasp_refine_apps.bench.align.bodies import BodyPair
from grasp_refine_apps.bench.align.labels import budget, labels_of
from grasp_refine_apps.bench.align.runner import Job
from grasp_refine_apps.bench.align.saved import AlignmentTask, Solid, Trajectory
from grasp_refine_apps.bench.align.tasks import CLASSES, Tasks
from grasp_refine_apps.bench.align.variants import Variant

MAX_ITERATES = 2001
"""Largest number of iterates in a trajectory: the start, and the paper's 2000 iterations."""


def record_task(
    pair: BodyPair,
    task: Tasks,
    variants: Sequence[Variant],
    *,
    seed: int,
    dtype: str = "float64",
    device: str = "cpu",
    progress: Callable[[float, str], None] = lambda share, what: None,
) -> AlignmentTask:
    """Return the task with one trajectory for each method.

    Args:
        pair: The two bodies.
        task: One task of these bodies.
        variants: Methods; of those that differ in their budget only, the one with the largest is run.
        seed: Seed of samples and restarts.
        dtype: Number type of poses and losses.
        device: Torch device of poses and losses.
        progress: Called with the share of the work that is done, and its label.
    """
    variants = largest_budgets(variants)
    labels = labels_of([variant.columns() for variant in variants])
    runs = []
    for number, (variant, label) in enumerate(zip(variants, labels, strict=True)):
        progress(number / len(variants), f"recording {label}")
        runs.append(_record(Job(variant, (pair,), (task,), seed, dtype, device, threads=1), label))
    return AlignmentTask(
        pair.kind,
        CLASSES[task.target_class[0]],
        (Solid(pair.a.name, pair.a.pieces), Solid(pair.b.name, pair.b.pieces)),
        np.stack([task.target_a[0], task.target_b[0]]),
        np.stack([task.T_world_a[0], task.T_world_b[0]]),
        tuple(runs),
    )


def largest_budgets(variants: Sequence[Variant]) -> list[Variant]:
    """Select the variant with the largest budget among those that differ in their budget only."""
    found: dict[Variant, Variant] = {}
    for variant in variants:
        method = replace(variant, budget=None, budget_s=None)
        if method not in found or budget(variant.columns()) > budget(found[method].columns()):
            found[method] = variant
    return list(found.values())


def shown_task(tasks: Tasks) -> Tasks:
    """Return the first task that is certainly solvable; without any, the first accepted one."""
    wanted = tasks.reachable & tasks.accepted
    return tasks.take(np.flatnonzero(wanted if wanted.any() else tasks.accepted)[:1])


def thin(count: int, keep: int) -> np.ndarray:
    """Select at most `MAX_ITERATES` of `count` iterates, evenly spread: the first, the last, and number `keep`."""
    if count <= MAX_ITERATES:
        return np.arange(count)
    return np.unique(np.append(np.linspace(0, count - 1, MAX_ITERATES - 1).round().astype(int), keep))


def _record(job: Job, label: str) -> Trajectory:
    """Run the only task of a job and record its trajectory."""
    poses: list[np.ndarray] = []
    times: list[float] = []

    def visit(T_world_a: np.ndarray, T_world_b: np.ndarray) -> None:
        poses.append(np.stack([T_world_a, T_world_b]))
        times.append(time.process_time())

    aligned = job.solved(lambda share: None, visit)
    T = np.stack(poses)
    given = np.stack([aligned.T_world_a[0, 0], aligned.T_world_b[0, 0]])
    result = int(np.nan_to_num(np.abs(T - given).max(axis=(1, 2, 3)), nan=np.inf).argmin())
    kept = thin(len(T), result)
    T = T[kept]
    task = job.tasks[0].take(np.zeros(len(kept), dtype=int))
    error, found = errors_at(job.pairs, [task], T[:, None, 0], T[:, None, 1], job.variant.margin)
    known = np.isfinite(error[:, 0])
    witness = np.stack([found.point_a[:, 0], found.point_b[:, 0]], axis=1)
    return Trajectory(
        label,
        job.variant.margin,
        int(np.flatnonzero(kept == result)[0]),
        kept,
        T,
        np.where(known[:, None, None], witness, np.nan),
        np.where(known, found.distance[:, 0], np.nan),
        np.where(known, error[:, 0], np.nan),
        np.array(times)[kept] - times[0],
    )
