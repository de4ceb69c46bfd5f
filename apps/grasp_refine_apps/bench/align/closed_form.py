"""Closed form of an alignment task: opposite normals at the targets, without a derivative or an iteration."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from grasp_refine.collision.query import Pairs
from grasp_refine.core.array_records import join
from grasp_refine.core.se3 import cross, exp_so3, matvec, tangents, transform, transform_points
from grasp_refine_apps.bench.align.aligned import AlignmentResult, errors_at, pad_tasks
from grasp_refine_apps.bench.align.bodies import BodyPair
from grasp_refine_apps.bench.align.pseudonormals import pseudonormals
from grasp_refine_apps.bench.align.stopwatch import Stopwatch
from grasp_refine_apps.bench.align.tasks import Tasks
from grasp_refine_apps.bench.align.variants import Variant


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """Poses with opposite normals at the targets, for the tasks of P pairs."""

    pairs: Pairs
    pair: np.ndarray
    """Pair (N,) of each task."""
    tasks: Tasks
    margin: float
    """Desired distance in metres."""

    def poses(self, member: np.ndarray, T_b: np.ndarray, roll: np.ndarray) -> np.ndarray:
        """Return poses (M, 4, 4) with opposite normals at the targets, and the margin between these along the normals.

        For convex bodies with a target on a vertex, these poses are solutions at every roll: the two planes across the
        normal separate the bodies. Other pieces of concave bodies may be in the way.

        Args:
            member: Tasks (M,).
            T_b: Poses of body b (M, 4, 4), which turns from there by the smallest angle, then about the normal.
            roll: Angles (M,) about the normal, radians.
        """
        T_a = self.tasks.T_world_a[member]
        n_a, n_b = (matvec(T[:, :3, :3], n[member]) for T, n in zip((T_a, T_b), self.target_normals, strict=True))
        least = turned(T_b, np.zeros((len(T_b), 3)), _smallest_rotation(n_b, -n_a), np.zeros((len(T_b), 3)))
        pivot = transform_points(least, self.tasks.target_b[member])
        goal = transform_points(T_a, self.tasks.target_a[member]) + self.margin * n_a
        return turned(least, pivot, roll[:, None] * n_a, goal)

    @cached_property
    def target_normals(self) -> tuple[np.ndarray, np.ndarray]:
        """Outward normals (N, 3) of the bodies a and b at the targets of all tasks, body frames."""
        found = []
        for bodies, target in ((self.pairs.a, self.tasks.target_a), (self.pairs.b, self.tasks.target_b)):
            normal = np.empty_like(target)
            for number, body in enumerate(bodies):
                rows = self.pair == number
                normal[rows] = pseudonormals(body.pieces, target[rows])
            found.append(normal)
        return found[0], found[1]


def run_closed_form(bodies: Sequence[BodyPair], tasks: Sequence[Tasks], variant: Variant) -> AlignmentResult:
    """Place body b of each task once, turned by the smallest angle that opposes the normals.

    Args:
        bodies: P pairs.
        tasks: Tasks of each pair; some pairs may have more than others.
        variant: Its margin is used.
    """
    watch, counts = Stopwatch(), np.array([len(pair_tasks) for pair_tasks in tasks])
    every, pair = join(*tasks), np.repeat(np.arange(len(bodies)), counts)
    pairs = Pairs(tuple(one.a for one in bodies), tuple(one.b for one in bodies))
    form = ClosedForm(pairs, pair, every, variant.margin)
    start_cpu, start_wall = time.process_time(), time.perf_counter()
    with watch:
        found = form.poses(np.arange(len(every)), every.T_world_b, np.zeros(len(every)))
    cpu_s, wall_s = time.process_time() - start_cpu, time.perf_counter() - start_wall
    task = np.arange(counts.max())[:, None]
    member = np.cumsum(counts) - counts + task % counts
    T_a, T_b = every.T_world_a[member], found[member]
    error = errors_at(bodies, pad_tasks(tasks), T_a, T_b, variant.margin)
    return AlignmentResult(error, T_a, T_b, (task < counts).astype(int), watch, cpu_s, wall_s)


def turned(T: np.ndarray, pivot: np.ndarray, w: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Rotate poses by rotation vectors w (M, 3), so that the points `pivot` (M, 3) of the bodies move to `to`."""
    R = exp_so3(w)
    moved = R @ T[:, :3, :3]
    moved = moved @ (1.5 * np.eye(3) - 0.5 * moved.mT @ moved)
    return transform(moved, to + matvec(R, T[:, :3, 3] - pivot))


def _smallest_rotation(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return rotation vectors (M, 3) of the smallest rotations that turn unit vectors `old` (M, 3) to `new` (M, 3)."""
    axis = cross(old, new)
    sine, cosine = np.sqrt((axis**2).sum(axis=1, keepdims=True)), (old * new).sum(axis=1, keepdims=True)
    # Half a turn may be about any axis across.
    known = sine > 1e-12
    axis = np.where(known, axis / np.where(known, sine, 1.0), tangents(old)[..., 0])
    return axis * np.arctan2(sine, cosine)
