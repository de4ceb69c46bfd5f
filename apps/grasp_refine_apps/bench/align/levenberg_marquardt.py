"""Levenberg-Marquardt on alignment tasks, least-squares problems over the pose of body b.

Each task ends when it is solved, or when its budget is used up.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.collision.query import Pairs, Witness, query_items
from grasp_refine.core.array_records import choose, join
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import cross, matvec, tangents, transform_points
from grasp_refine.refinement.solvers.iterate import Point, minimise
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.rows import Linear
from grasp_refine.witness.contact_kinematics import contact_slip_jacobian
from grasp_refine.witness.pair_curvature import SMALLEST_CURVATURE, PairCurvatures
from grasp_refine_apps.bench.align.aligned import AlignmentResult, errors_at, pad_tasks
from grasp_refine_apps.bench.align.bodies import BodyPair
from grasp_refine_apps.bench.align.closed_form import ClosedForm, turned
from grasp_refine_apps.bench.align.patch import Patch
from grasp_refine_apps.bench.align.restarts import generator, random_rotation
from grasp_refine_apps.bench.align.stopwatch import Stopwatch
from grasp_refine_apps.bench.align.tasks import Tasks
from grasp_refine_apps.bench.align.variants import Variant

TOLERANCE_M2 = 1e-14
"""Errors (m^2) below this, a tenth of a micrometre, end a task."""

RADIUS_FACTORS = (1.0, 0.5, 2.0, 0.25, 0.0)
"""Factors of the neighbourhoods' radii, one after the other at each rejection; 0: no smoothing."""

MAX_ROTATION_RAD = 2.0
"""Largest rotation of a step in radians."""


def run_levenberg_marquardt(
    bodies: Sequence[BodyPair],
    tasks: Sequence[Tasks],
    variant: Variant,
    *,
    seed: int = 0,
    progress: Callable[[float], None] = lambda share: None,
) -> AlignmentResult:
    """Run the tasks of several pairs together; the result of a task does not depend on the others.

    Witness points are differentiated by contact kinematics. A stalled task restarts without limit.

    Args:
        bodies: P pairs.
        tasks: Tasks of each pair; some pairs may have more than others.
        variant: Margin, budget in iterations, each one witness query, and witness.
        seed: Seed of restarts.
        progress: Called from time to time with the share of the budget that is used.
    """
    budget = variant.budget
    assert budget is not None, "only descent has a time budget"
    watch = Stopwatch()
    problem = AlignProblem(
        bodies, tasks, variant.margin, seed, variant.solver_patch, watch, with_closed_form=variant.with_closed_form
    )
    counts = np.array([len(pair_tasks) for pair_tasks in tasks])
    first = np.cumsum(counts) - counts
    start = Point(problem.tasks.T_world_b, np.zeros((counts.sum(), 0)))
    # Caches built at the first call are not part of the loop's time.
    problem.evaluate(first, Point(start.T[first], start.q[first]), None)
    most = budget * -(-counts.sum() // problem.width)

    def report(done: int, iteration: int, loss: float) -> None:
        if iteration % 10 == 0:
            progress(min(iteration / most, 1.0))

    settings = LevenbergMarquardt(
        iterations=budget,
        restarts=budget,
        good=0.0,
        widths=RADIUS_FACTORS,
    )
    start_cpu, start_wall = time.process_time(), time.perf_counter()
    with watch:
        found = minimise(problem, start, settings, TOLERANCE_M2, progress=report)
    cpu_s, wall_s = time.process_time() - start_cpu, time.perf_counter() - start_wall
    task = np.arange(counts.max())[:, None]
    member = first + task % counts
    T_a, T_b = problem.tasks.T_world_a[member], found.point.T[member]
    error = errors_at(bodies, pad_tasks(tasks), T_a, T_b, variant.margin)
    iterations = np.where(task < counts, found.iterations[member], 0)
    return AlignmentResult(error, T_a, T_b, iterations, watch, cpu_s, wall_s)


@dataclass(frozen=True, eq=False)
class Known:
    """Evaluated tasks; M rows."""

    residual: np.ndarray
    """[d - beta, E^T (x_a - t_a), E^T (x_b - t_b)] (M, 5): misses along the normal have no derivative."""
    loss: np.ndarray
    """(d - beta)^2 + |x_a - t_a|^2 + |x_b - t_b|^2 (M,) in square metres."""
    num_queries: np.ndarray
    witness: Witness
    E: np.ndarray
    """Tangents (M, 3, 2)."""
    pivot: np.ndarray
    """Target of body b (M, 3), world frame: steps rotate about it."""
    miss: np.ndarray
    """|x_a - t_a| and |x_b - t_b| (M, 2) in metres."""


class AlignProblem:
    """The tasks of P pairs of bodies; bodies a are fixed."""

    width, restarts = 2048, True

    def __init__(
        self,
        bodies: Sequence[BodyPair],
        tasks: Sequence[Tasks],
        margin: float,
        seed: int,
        patch: Patch | None = None,
        watch: Stopwatch | None = None,
        *,
        with_closed_form: bool = False,
    ) -> None:
        """Set up the tasks; members are the tasks of the first pair, then of the second, and so on.

        Args:
            bodies: P pairs.
            tasks: Tasks of each pair.
            margin: The desired distance in metres.
            seed: Seed of restarts.
            patch: Patch witness that is used; None: plain witness points.
            watch: Stopwatch of the passes.
            with_closed_form: Whether restarts include the closed form.
        """
        self.watch = Stopwatch() if watch is None else watch
        self.pairs = Pairs(tuple(pair.a for pair in bodies), tuple(pair.b for pair in bodies))
        self.pair = np.repeat(np.arange(len(bodies)), [len(t) for t in tasks])
        self.tasks, self.margin, self.seed, self.patch = join(*tasks), margin, seed, patch
        self.curvatures = PairCurvatures.of(self.pairs, SMALLEST_CURVATURE)
        self.length = np.array([0.25 * (pair.a.diagonal + pair.b.diagonal) for pair in bodies])
        self.closed = ClosedForm(self.pairs, self.pair, self.tasks, margin) if with_closed_form else None
        self.several = any(len(body.pieces) > 1 for body in (*self.pairs.a, *self.pairs.b))

    def evaluate(self, member: np.ndarray, point: Point, previous: Known | None) -> Known:
        """Evaluate each task by one query."""
        with self.watch.lap("forward"):
            return self._evaluated(member, point, previous)

    def _evaluated(self, member: np.ndarray, point: Point, previous: Known | None) -> Known:
        T_a = self.tasks.T_world_a[member]
        before = previous.witness if previous is not None and self.several else None
        with stage("broad phase"):
            w = self._witness(self.pair[member], T_a, point.T, before, member)
        pivot = transform_points(point.T, self.tasks.target_b[member])
        miss_a = w.point_a - transform_points(T_a, self.tasks.target_a[member])
        miss_b = w.point_b - pivot
        E = tangents(w.normal)
        gap = w.distance - self.margin
        residual = np.concatenate([gap[:, None], matvec(E.mT, miss_a), matvec(E.mT, miss_b)], axis=1)
        a, b = (miss_a**2).sum(axis=1), (miss_b**2).sum(axis=1)
        loss = np.where(w.valid, gap**2 + a + b, np.nan)
        return Known(residual, loss, w.num_queries, w, E, pivot, np.sqrt(np.stack([a, b], axis=1)))

    def linearize(self, member: np.ndarray, point: Point, known: Known, width: np.ndarray) -> Linear:
        """Return residuals (M, 5) and Jacobians (M, 5, 6) in the twist of body b about its target."""
        with self.watch.lap("backward"), stage("derivative"):
            return Linear(known.residual, self._jacobian(member, point, known, width))

    def _jacobian(self, member: np.ndarray, point: Point, known: Known, width: np.ndarray) -> np.ndarray:
        w = known.witness
        T_a = self.tasks.T_world_a[member]
        K_a, K_b = self.curvatures.fit(self.pair[member], T_a, point.T, w, known.E, known.miss.T, width)
        arm = w.point_b - known.pivot
        U_a, U_b = contact_slip_jacobian(arm, w.normal, w.distance, known.E, K_a, K_b)
        gap = np.concatenate([w.normal, cross(arm, w.normal)], axis=1)[:, None]
        return np.concatenate([gap, U_a, U_b], axis=1)

    def _witness(
        self, pair: np.ndarray, T_a: np.ndarray, T_b: np.ndarray, before: Witness | None, member: np.ndarray
    ) -> Witness:
        """Query plain or patch witness points."""
        found = query_items(self.pairs, pair, T_a, T_b, previous=before)
        if self.patch is None:
            return found
        goals = self.tasks.target_a[member], self.tasks.target_b[member]
        return self.patch.refine(self.pairs, T_a, T_b, found, *goals)

    def metric(self, member: np.ndarray) -> np.ndarray:
        """Return a quarter of both diagonals, l: W = diag(1, 1, 1, l^2, l^2, l^2)."""
        length = self.length[self.pair[member], None]
        return np.concatenate([np.ones((len(member), 3)), np.repeat(length**2, 3, axis=1)], axis=1)

    def step_bounds(self, member: np.ndarray, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """Return infinite bounds: there are none."""
        free = np.full((len(member), 6), np.inf)
        return -free, free

    def integrate(self, member: np.ndarray, point: Point, dx: np.ndarray) -> Point:
        """Rotate body b about its target."""
        pivot = transform_points(point.T, self.tasks.target_b[member])
        turn = np.sqrt((dx[:, 3:] ** 2).sum(axis=1, keepdims=True))
        dx = dx * (MAX_ROTATION_RAD / np.maximum(turn, MAX_ROTATION_RAD))
        return Point(turned(point.T, pivot, dx[:, 3:], pivot + dx[:, :3]), point.q)

    def restart(self, member: np.ndarray, start: np.ndarray, best: Point, now: Point) -> Point:
        """Rotate body b about its target, and place this target on the target of body a.

        A large random rotation from the current pose alternates with a small one from the best pose. With the closed
        form, it comes before both: at first turning as little as possible from the best pose, later with a random roll.
        """
        # 1: the closed form, 2: large, 0: small.
        kind = start % 3 if self.closed is not None else np.where(start % 2 == 1, 2, 0)
        w, roll = np.zeros((len(member), 3)), np.zeros(len(member))
        for row, (m, k, way) in enumerate(zip(member.tolist(), start.tolist(), kind.tolist(), strict=True)):
            rng = generator(self.seed, self.tasks.T_world_b[m], k)
            if way == 1:
                roll[row] = rng.uniform(0.0, 2.0 * np.pi) if k > 1 else 0.0
            else:
                w[row] = random_rotation(rng, far=way == 2)
        T = choose(kind == 2, now.T, best.T)
        pivot = transform_points(T, self.tasks.target_b[member])
        goal = transform_points(self.tasks.T_world_a[member], self.tasks.target_a[member])
        drawn = turned(T, pivot, w, goal)
        return Point(
            drawn if self.closed is None else choose(kind == 1, self.closed.poses(member, T, roll), drawn), now.q
        )
