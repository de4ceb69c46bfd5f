"""Loop of Levenberg-Marquardt over a batch: accept, restart, remove finished members, add waiting ones.

Finished members leave the batch at once, and waiting ones take their places, so that stragglers seldom run alone. The
result of a member does not depend on the others: random numbers are those of the member.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf
from typing import Any, Protocol, runtime_checkable

import numpy as np

from grasp_refine.core.array_records import choose, join, take
from grasp_refine.core.profiling import stage
from grasp_refine.core.short_repr import brief
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt, bounded_step
from grasp_refine.refinement.solvers.status import Status

WIDTH = 2048
"""Largest number of members that are solved at once."""

Progress = Callable[[int, int, float], None]
"""Called with the number of finished members, the iteration, and the mean loss of the members still running."""


@dataclass(frozen=True, eq=False)
class Point:
    """Poses and joint values of members."""

    T: np.ndarray
    """Poses (batch, 4, 4) of the moving body."""
    q: np.ndarray
    """Joint values (batch, n); n may be 0."""

    __repr__ = brief


IterationCallback = Callable[[np.ndarray, Point, np.ndarray], None]
"""Called with members (M,), their points after an iteration, and their losses (M,); may raise to end the run."""


@dataclass(frozen=True, eq=False)
class Linear:
    """Residuals of members and their derivatives."""

    residual: np.ndarray
    """Residuals (batch, m) that have a derivative."""
    jacobian: np.ndarray
    """Derivatives (batch, m, dof) of the residuals in the unknowns of a step."""
    unilateral: np.ndarray | None = None
    """Rows (batch, m) that count only where they are positive; None: none."""

    __repr__ = brief

    def with_rows(self, weight: float, residual: np.ndarray, jacobian: np.ndarray) -> Linear:
        """Return a copy with further residuals (batch, k), whose squares have this weight."""
        scale = np.sqrt(weight)
        unilateral = self.unilateral
        if unilateral is not None:
            unilateral = np.concatenate([unilateral, np.zeros(residual.shape, dtype=bool)], axis=1)
        return Linear(
            np.concatenate([self.residual, scale * residual], axis=1),
            np.concatenate([self.jacobian, scale * jacobian], axis=1),
            unilateral,
        )


@runtime_checkable
class Evaluated(Protocol):
    """Evaluation of members at a point, rows of arrays."""

    loss: np.ndarray
    """Sum of the squares of all residuals (batch,); NaN where it is not known."""
    num_queries: np.ndarray
    """Narrow-phase queries (batch,)."""


@runtime_checkable
class Problem(Protocol):
    """Independent least-squares problems of the same form, one for each member."""

    def metric(self, member: np.ndarray) -> np.ndarray:
        """Return the diagonals of W (batch, dof): the squared movement of a unit of each unknown."""
        ...

    def evaluate(self, member: np.ndarray, point: Point, previous: Any | None) -> Any:
        """Return the evaluation at a point (an `Evaluated`); `previous` is one nearby, a warm start.

        A point whose loss is not below `previous.loss` will be rejected: as soon as that is certain, the returned loss
        may be any value between the two. `previous.loss` is infinite where a member restarts.
        """
        ...

    def linearize(self, member: np.ndarray, point: Point, known: Any, width: np.ndarray) -> Linear:
        """Return residuals and derivatives; `width` (batch,) multiplies the radii of neighbourhoods."""
        ...

    def step_bounds(self, member: np.ndarray, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """Return lower and upper bounds of a step (batch, dof)."""
        ...

    def integrate(self, member: np.ndarray, point: Point, dx: np.ndarray) -> Point:
        """Return the points after steps (batch, dof)."""
        ...

    def restart(self, member: np.ndarray, start: np.ndarray, best: Point, now: Point) -> Point:
        """Return new starts of stalled members, the `start`-th (batch,) of each, by member and number only."""
        ...


@dataclass(frozen=True, eq=False)
class Minimum:
    """Result of N members."""

    point: Point
    """Best iterate of each by true loss."""
    loss: np.ndarray
    """Loss at the start and at the best iterate (N, 2)."""
    status: np.ndarray
    """A `Status` for each (N,)."""
    iterations: np.ndarray
    """Iterations (N,), each one collision query."""
    queries: np.ndarray
    """Narrow-phase queries (N,)."""
    cpu_s: np.ndarray
    """Share of the CPU time (N,), seconds."""
    wall_s: np.ndarray
    """Share of the wall time (N,), seconds."""

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class _Slots:
    """Active members, one row each."""

    member: np.ndarray
    point: Point
    known: Any
    """Evaluation at the point."""
    loss: np.ndarray
    """Loss at the point; infinite before a start is evaluated."""
    trial: Point
    """The point that is evaluated next."""
    predicted: np.ndarray
    """Predicted fall of the loss at the trial."""
    damping: np.ndarray
    rejections: np.ndarray
    mark: np.ndarray
    """Loss at the last progress."""
    since: np.ndarray
    """Iterations since the last progress."""
    starts: np.ndarray
    """Starts so far."""


@stage("solver")
def minimise(
    problem: Problem,
    start: Point,
    solver: LevenbergMarquardt,
    tolerance: float,
    *,
    status: np.ndarray | None = None,
    width: int = WIDTH,
    seconds: float | np.ndarray = inf,
    progress: Progress | None = None,
    on_iteration: IterationCallback | None = None,
) -> Minimum:
    """Minimise all members.

    Args:
        problem: Least-squares problems of the N members.
        start: Initial points of the N members.
        solver: Settings.
        tolerance: A member has converged when its loss is below this.
        status: Members (N,) with another status than RUNNING are left out.
        width: Largest number of members that are solved at once.
        seconds: A member whose share of the CPU time is above this, a number for all or for each (N,), ends.
        progress: Called after each iteration with the number of finished members, the iteration, and the mean
            best loss of those still running.
        on_iteration: Called with members at their start and after each of their iterations.
    """
    count = len(start.T)
    status = np.full(count, Status.RUNNING) if status is None else status.copy()
    run = _Run(problem, solver, tolerance, np.broadcast_to(seconds, count), start, status, on_iteration)
    waiting = np.flatnonzero(run.status == Status.RUNNING)
    slots: _Slots | None = None
    iteration = 0
    while len(waiting) or (slots is not None and len(slots.member)):
        wall, cpu = time.perf_counter(), time.process_time()
        members = np.zeros(0, dtype=np.int64) if slots is None else slots.member
        if slots is not None and len(members):
            slots = run.judge(slots, problem.evaluate(members, slots.trial, slots.known))
        free = width - (0 if slots is None else len(slots.member))
        # A few free places are not worth the copying.
        if len(waiting) and free >= max(1, min(len(waiting), width // 8)):
            entering, waiting = waiting[:free], waiting[free:]
            members = np.concatenate([members, entering])
            new = run.enter(entering)
            slots = new if slots is None else join(slots, new)
        assert slots is not None  # it had members, or some have entered
        if len(slots.member):
            slots = run.step(slots)
        share = 1.0 / len(members)
        run.wall_s[members] += (time.perf_counter() - wall) * share
        run.cpu_s[members] += (time.process_time() - cpu) * share
        iteration += 1
        if progress is not None:
            known = run.best_loss[members]
            known = known[np.isfinite(known)]
            done = count - len(slots.member) - len(waiting)
            progress(done, iteration, float(known.mean()) if len(known) else 0.0)
    loss = np.stack([run.first_loss, run.best_loss], axis=1)
    return Minimum(run.best, loss, run.status, run.iterations, run.queries, run.cpu_s, run.wall_s)


class _Run:
    """Best iterates and cost of all members, and the parts of an iteration."""

    def __init__(
        self,
        problem: Problem,
        solver: LevenbergMarquardt,
        tolerance: float,
        seconds: np.ndarray,
        start: Point,
        status: np.ndarray,
        on_iteration: IterationCallback | None,
    ) -> None:
        count = len(start.T)
        self.problem, self.solver, self.status, self.on_iteration = problem, solver, status, on_iteration
        self.tolerance, self.seconds = tolerance, seconds
        self.best = Point(start.T.copy(), start.q.copy())
        self.best_loss, self.first_loss = np.full(count, np.inf), np.full(count, np.nan)
        self.iterations, self.queries = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        self.cpu_s, self.wall_s = np.zeros(count), np.zeros(count)
        self.widths = np.array(solver.widths)
        # Best loss when it last fell notably, and the iteration of that.
        self.best_mark, self.best_at = np.full(count, np.inf), np.zeros(count, dtype=np.int64)

    def enter(self, member: np.ndarray) -> _Slots:
        """Return slots of the members that begin, without those that end at once."""
        point = take(self.best, member)
        known = self.problem.evaluate(member, point, None)
        self.first_loss[member] = known.loss
        M = len(member)
        never, none = np.full(M, np.inf), np.zeros(M, dtype=np.int64)
        slots = _Slots(
            member, point, known, never, point, np.zeros(M), np.full(M, self.solver.damping), none, never, none, none
        )
        return self.judge(slots, known)

    def judge(self, slots: _Slots, known: Any) -> _Slots:
        """Accept or reject evaluated trials; return the slots without those that end, stalled ones restarted."""
        solver, member = self.solver, slots.member
        self.iterations[member] += 1
        self.queries[member] += known.num_queries
        starting = np.isinf(slots.loss)
        accepted = known.loss < slots.loss
        fall = np.where(starting, 0.0, slots.loss) - known.loss
        # A start has no prediction; a floor at the smallest number would overflow.
        ratio = fall / np.maximum(slots.predicted, 1e-200)
        damping = np.where(starting, slots.damping, solver.updated_damping(slots.damping, accepted, ratio))
        loss = np.where(accepted, known.loss, slots.loss)
        better = np.flatnonzero(loss < self.best_loss[member])
        self.best_loss[member[better]] = loss[better]
        self.best.T[member[better]], self.best.q[member[better]] = slots.trial.T[better], slots.trial.q[better]
        progressed = loss < (1.0 - solver.progress) * slots.mark
        since = np.where(progressed, 0, slots.since + 1)
        slots = _Slots(
            member,
            choose(accepted, slots.trial, slots.point),
            choose(accepted, known, slots.known),
            loss,
            slots.trial,
            slots.predicted,
            damping,
            np.where(starting, 0, slots.rejections + ~accepted),
            np.where(progressed, loss, slots.mark),
            since,
            slots.starts + starting,
        )
        if self.on_iteration is not None:
            self.on_iteration(member, slots.point, loss)
        more = (slots.starts <= solver.restarts) & (self.best_loss[member] >= solver.good)
        patience = np.where(more, solver.patience, solver.last_patience)
        stuck = (since >= patience) | (damping > solver.largest) | np.isinf(loss)
        again = stuck & more
        best = self.best_loss[member]
        fell = best < (1.0 - solver.progress) * self.best_mark[member]
        self.best_mark[member[fell]], self.best_at[member[fell]] = best[fell], self.iterations[member[fell]]
        spent = (self.iterations[member] >= solver.iterations) | (self.cpu_s[member] >= self.seconds[member])
        idle = self.iterations[member] - self.best_at[member] >= solver.last_patience
        ends = (
            (spent, Status.BUDGET),
            ((stuck & ~again) | (spent & idle), Status.STALLED),
            (np.isinf(self.best_loss[member]), Status.NOT_FINITE),
            (self.best_loss[member] < self.tolerance, Status.CONVERGED),
        )
        for mask, status in ends:
            self.status[member[mask]] = status
        ended = np.logical_or.reduce([mask for mask, _ in ends])
        again = np.flatnonzero(again & ~ended)
        if len(again):
            slots = self._restart(slots, again)
        return take(slots, ~ended) if ended.any() else slots

    def _restart(self, slots: _Slots, rows: np.ndarray) -> _Slots:
        """Return the slots with new starts in some rows."""
        member = slots.member[rows]
        trial = self.problem.restart(member, slots.starts[rows], take(self.best, member), take(slots.point, rows))
        T, q, loss, mark = (array.copy() for array in (slots.trial.T, slots.trial.q, slots.loss, slots.mark))
        damping, since = slots.damping.copy(), slots.since.copy()
        T[rows], q[rows], loss[rows], mark[rows] = trial.T, trial.q, np.inf, np.inf
        damping[rows], since[rows] = self.solver.damping, 0
        known = replace(slots.known, loss=np.where(np.isinf(loss), np.inf, slots.known.loss))
        return replace(slots, known=known, trial=Point(T, q), loss=loss, mark=mark, damping=damping, since=since)

    def step(self, slots: _Slots) -> _Slots:
        """Return the slots with their next trials."""
        problem, member = self.problem, slots.member
        width = self.widths[slots.rejections % len(self.widths)]
        linear = problem.linearize(member, slots.point, slots.known, width)
        lower, upper = problem.step_bounds(member, slots.point)
        dx, predicted = bounded_step(
            linear.jacobian, linear.residual, slots.damping, problem.metric(member), lower, upper, linear.unilateral
        )
        trial = problem.integrate(member, slots.point, dx)
        starting = np.isinf(slots.loss)
        if starting.any():
            trial = choose(starting, slots.trial, trial)
        return replace(slots, trial=trial, predicted=predicted)
