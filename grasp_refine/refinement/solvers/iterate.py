"""The loop over iterations, for all solvers: evaluate, accept, restart, remove finished members, add waiting ones.

Finished members leave the batch at once, and waiting ones take their places, so that stragglers seldom run alone. The
result of a member does not depend on the others: each member has its own random numbers.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from math import inf
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np

from grasp_refine.core.arguments import check_kind, describe_value
from grasp_refine.core.array_records import choose, join, take
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.profiling import stage
from grasp_refine.core.short_repr import brief
from grasp_refine.refinement.solvers.status import Status

AGREEMENT = 0.1
"""Relative difference of losses up to which two starts of a member ended alike."""

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


@runtime_checkable
class Problem(Protocol):
    """Independent minimisation problems of the same form, one for each member."""

    width: int
    """Largest number of members that are evaluated at once."""
    restarts: bool
    """Whether a stalled member may start elsewhere, at `restart(member, start, best, now)`.

    It returns new starts of stalled members, the `start`-th (batch,) of each, by member and number only, given the best
    and the present points."""

    def evaluate(self, member: np.ndarray, point: Point, previous: Any | None) -> Any:
        """Return the evaluation at a point; `previous` is one nearby, a warm start.

        It is a record of arrays with at least `loss` (batch,), the sum of the squares of all residuals, NaN where it is
        not known, and `num_queries` (batch,), of the narrow phase.

        For solvers that compare losses, a point whose loss is not below `previous.loss` will be rejected: as soon as
        that is certain, the returned loss may be any value between the two. `previous.loss` is infinite where a member
        restarts.
        """
        ...


@dataclass(frozen=True, eq=False)
class Slots:
    """Active members, one row each."""

    member: np.ndarray
    point: Point
    """Last accepted points."""
    known: Any
    """Evaluation at these."""
    loss: np.ndarray
    """Loss at these; infinite before a start is evaluated."""
    trial: Point
    """The points that are evaluated next."""
    mark: np.ndarray
    """Loss at the last progress."""
    since: np.ndarray
    """Iterations since the last progress."""
    starts: np.ndarray
    """Starts so far."""
    state: Any
    """Numbers of the solver, a record of arrays."""


@dataclass(frozen=True, eq=False)
class Record:
    """Past of active members (batch,)."""

    best_loss: np.ndarray
    """Best loss of all iterates."""
    iterations: np.ndarray
    """Iterations so far."""
    idle: np.ndarray
    """Iterations since the best loss last fell notably."""
    agreeing: np.ndarray
    """Starts that ended within a tenth of the best loss; one, where that has fallen by more since they began to."""
    spent: np.ndarray
    """Whether the iterations or the time of the member are used up."""


@runtime_checkable
class Solver(Protocol):
    """Settings of a solver and the parts of an iteration that are its own; any class with these members is one.

    A problem of least squares has `linearize`, `metric`, `step_bounds` and `integrate` (`LeastSquares`); evaluations of
    a problem of gradients have `gradient` (`Differentiable`).
    """

    @property
    def needs_autograd(self) -> bool:
        """Whether it follows gradients of torch graphs; otherwise it solves linear problems of residuals."""
        ...

    @property
    def iterations(self) -> int:
        """Largest number of iterations of a member."""
        ...

    @property
    def progress(self) -> float:
        """Smallest relative fall of the loss that counts as progress."""
        ...

    def start(self, problem: Any, point: Point) -> tuple[Point, Any]:
        """Return the points at which members start, near the given ones, and the initial state.

        A state is an array with a row for each member, or a dataclass of such arrays.
        """
        ...

    def accept(self, slots: Slots, known: Any) -> tuple[np.ndarray, Any]:
        """Return which trials, evaluated as `known`, are accepted (batch,), and the next state."""
        ...

    def assess(self, problem: Any, slots: Slots, record: Record) -> tuple[Slots, np.ndarray, np.ndarray]:
        """Return the slots with an updated state, the `Status` of each member (batch,), and which should restart."""
        ...

    def step(self, problem: Any, slots: Slots) -> tuple[Point, Any]:
        """Return the next trials and state."""
        ...


def check_solver(solver: object) -> None:
    """Refuse what is no solver.

    Raises:
        GraspRefineError: names what is missing or of another type.
    """
    if isinstance(solver, type):
        raise GraspRefineError(f"a solver is needed, got the class {solver.__name__} itself: {solver.__name__}()")
    members = ("needs_autograd", "iterations", "progress", "start", "accept", "assess", "step")
    lacking = [member for member in members if not hasattr(solver, member)]
    if lacking:
        raise GraspRefineError(
            f"{describe_value(solver)} is no solver: it lacks {', '.join(lacking)}; give LevenbergMarquardt(), "
            "Descent(), Adam(), or one of your own, see Solver"
        )
    assert isinstance(solver, Solver)
    name = type(solver).__name__
    check_kind(f"{name}: needs_autograd", solver.needs_autograd, bool)
    check_kind(f"{name}: iterations", solver.iterations, int)
    check_kind(f"{name}: progress", solver.progress, float)
    for member in members[3:]:
        check_kind(f"{name}: {member}", getattr(solver, member), Callable)


def limited(solver: Solver, **most: int) -> Solver:
    """Return a copy of a solver whose numbers of some names are at most as given; names that it has not are ignored."""
    solver = copy(solver)
    for name in most.keys() & set(dir(solver)):
        object.__setattr__(solver, name, min(getattr(solver, name), most[name]))
    return solver


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


@stage("solver")
def minimise(
    problem: Problem,
    start: Point,
    solver: Solver,
    tolerance: float,
    *,
    status: np.ndarray | None = None,
    seconds: float | np.ndarray = inf,
    progress: Progress | None = None,
    on_iteration: IterationCallback | None = None,
) -> Minimum:
    """Minimise the losses of all members.

    Args:
        problem: Problems of the N members, such as the solver can solve.
        start: Initial points of the N members.
        solver: Solver with its settings.
        tolerance: A member has converged when its loss is below this.
        status: Members (N,) with another status than RUNNING are left out.
        seconds: A member whose share of the CPU time is above this, a number for all or for each (N,), ends.
        progress: Called after each iteration with the number of finished members, the iteration, and the mean
            best loss of the running members.
        on_iteration: Called with members at their start and after each of their iterations.
    """
    count, width = len(start.T), problem.width
    status = np.full(count, Status.RUNNING) if status is None else status.copy()
    run = _Run(problem, solver, tolerance, np.broadcast_to(seconds, count), start, status, on_iteration)
    waiting = np.flatnonzero(run.status == Status.RUNNING)
    slots: Slots | None = None
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
            slots = new if slots is None or not len(slots.member) else join(slots, new)
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
        solver: Solver,
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
        # Starts that agree on a best loss, and that loss.
        self.agreeing, self.agreed_loss = np.zeros(count, dtype=np.int64), np.full(count, np.inf)
        # Best loss when it last fell notably, and the iteration of that.
        self.best_mark, self.best_at = np.full(count, np.inf), np.zeros(count, dtype=np.int64)

    def enter(self, member: np.ndarray) -> Slots:
        """Return slots of the members that begin and do not end at once."""
        point, state = self.solver.start(self.problem, take(self.best, member))
        known = self.problem.evaluate(member, point, None)
        self.first_loss[member] = known.loss
        never, none = np.full(len(member), np.inf), np.zeros(len(member), dtype=np.int64)
        return self.judge(Slots(member, point, known, never, point, never, none, none, state), known)

    def judge(self, slots: Slots, known: Any) -> Slots:
        """Accept or reject evaluated trials; return the slots that continue, stalled ones restarted."""
        member, progress = slots.member, self.solver.progress
        self.iterations[member] += 1
        self.queries[member] += known.num_queries
        accepted, state = self.solver.accept(slots, known)
        loss = np.where(accepted, known.loss, slots.loss)
        better = np.flatnonzero(loss < self.best_loss[member])
        self.best_loss[member[better]] = loss[better]
        self.best.T[member[better]], self.best.q[member[better]] = slots.trial.T[better], slots.trial.q[better]
        progressed = loss < (1.0 - progress) * slots.mark
        slots = Slots(
            member,
            choose(accepted, slots.trial, slots.point),
            choose(accepted, known, slots.known),
            loss,
            slots.trial,
            np.where(progressed, loss, slots.mark),
            np.where(progressed, 0, slots.since + 1),
            slots.starts + np.isinf(slots.loss),
            state,
        )
        if self.on_iteration is not None:
            self.on_iteration(member, slots.point, loss)
        best, iterations = self.best_loss[member], self.iterations[member]
        fell = best < (1.0 - progress) * self.best_mark[member]
        self.best_mark[member[fell]], self.best_at[member[fell]] = best[fell], iterations[fell]
        spent = (iterations >= self.solver.iterations) | (self.cpu_s[member] >= self.seconds[member])
        record = Record(best, iterations, iterations - self.best_at[member], self.agreeing[member], spent)
        slots, status, again = self.solver.assess(self.problem, slots, record)
        status[(status == Status.RUNNING) & spent] = Status.BUDGET
        status[np.isinf(best)] = Status.NOT_FINITE
        status[best < self.tolerance] = Status.CONVERGED
        self.status[member] = status
        running = status == Status.RUNNING
        again = np.flatnonzero(again & running)
        if len(again):
            slots = self._restart(slots, again)
        return slots if running.all() else take(slots, running)

    def _restart(self, slots: Slots, rows: np.ndarray) -> Slots:
        """Return the slots with new starts in some rows."""
        problem, member = cast(Any, self.problem), slots.member[rows]
        best, ended = self.best_loss[member], slots.loss[rows]
        fell = best < (1.0 - AGREEMENT) * self.agreed_loss[member]
        self.agreed_loss[member[fell]] = best[fell]
        self.agreeing[member] = np.where(fell, 1, self.agreeing[member] + (ended < (1.0 + AGREEMENT) * best))
        trial = problem.restart(member, slots.starts[rows], take(self.best, member), take(slots.point, rows))
        trial, state = self.solver.start(problem, trial)
        place = np.arange(len(slots.member))
        place[rows] = len(place) + np.arange(len(rows))
        never = np.isin(place, place[rows])
        loss = np.where(never, np.inf, slots.loss)
        return replace(
            slots,
            known=replace(slots.known, loss=np.where(never, np.inf, slots.known.loss)),
            loss=loss,
            trial=take(join(slots.trial, trial), place),
            mark=np.where(never, np.inf, slots.mark),
            since=np.where(never, 0, slots.since),
            state=take(join(slots.state, state), place),
        )

    def step(self, slots: Slots) -> Slots:
        """Return the slots with their next trials; members that start are evaluated where they start."""
        trial, state = self.solver.step(self.problem, slots)
        starting = np.isinf(slots.loss)
        return replace(slots, trial=choose(starting, slots.trial, trial), state=state)
