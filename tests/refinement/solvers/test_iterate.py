"""The loop over iterations, on problems in closed form: ends, true losses, restarts, and members on their own."""

from collections import defaultdict
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from grasp_refine.refinement.solvers.iterate import Minimum, Point, minimise
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.solvers.rows import Linear
from grasp_refine.refinement.solvers.status import Status

SOLVER = LevenbergMarquardt(iterations=200, restarts=0)


@dataclass(frozen=True, eq=False)
class Known:
    loss: np.ndarray
    num_queries: np.ndarray
    q: np.ndarray


@dataclass
class Valley:
    """Rosenbrock's valley r = [10 (y - x^2), a - x], its minimum at (a, a^2), with another a for each member."""

    a: np.ndarray
    rest: float = 0.0
    """What no step takes away: another residual."""
    width: int = 2048
    restarts: bool = True
    box: float = 0.5
    """Longest step of each unknown."""
    seen: dict[int, list[tuple[np.ndarray, float]]] = field(default_factory=lambda: defaultdict(list))
    """Points and losses of each member, as they were evaluated."""
    taken: dict[int, list[tuple[np.ndarray, float]]] = field(default_factory=lambda: defaultdict(list))
    """Those from which steps were taken."""
    widths: dict[int, list[float]] = field(default_factory=lambda: defaultdict(list))
    most: int = 0
    """Most members that were asked for at once."""

    def residual(self, member: np.ndarray, q: np.ndarray) -> np.ndarray:
        x, y = q.T
        return np.stack([10.0 * (y - x * x), self.a[member] - x, np.full(len(q), self.rest)], axis=1)

    def jacobian(self, member: np.ndarray, q: np.ndarray) -> np.ndarray:
        x, zero, one = q[:, 0], np.zeros(len(q)), np.ones(len(q))
        return np.stack([-20.0 * x, 10.0 * one, -one, zero, zero, zero], axis=1).reshape(-1, 3, 2)

    def metric(self, member: np.ndarray) -> np.ndarray:
        return np.ones((len(member), 2))

    def evaluate(self, member: np.ndarray, point: Point, previous: Known | None) -> Known:
        loss = (self.residual(member, point.q) ** 2).sum(axis=1)
        self.most = max(self.most, len(member))
        for m, q, value in zip(member.tolist(), point.q, loss, strict=True):
            self.seen[m].append((q.copy(), float(value)))
        return Known(loss, 2 + member % 3, point.q)

    def linearize(self, member: np.ndarray, point: Point, known: Known, width: np.ndarray) -> Linear:
        # What is known is known of this very point, however members come and go.
        np.testing.assert_array_equal(known.q, point.q)
        for m, q, value, one in zip(member.tolist(), point.q, known.loss, width, strict=True):
            self.taken[m].append((q.copy(), float(value)))
            self.widths[m].append(float(one))
        return Linear(self.residual(member, point.q), self.jacobian(member, point.q))

    def step_bounds(self, member: np.ndarray, point: Point) -> tuple[np.ndarray, np.ndarray]:
        return np.full(point.q.shape, -self.box), np.full(point.q.shape, self.box)

    def integrate(self, member: np.ndarray, point: Point, dx: np.ndarray) -> Point:
        return Point(point.T, point.q + dx)

    def restart(self, member: np.ndarray, start: np.ndarray, best: Point, now: Point) -> Point:
        draws = [np.random.default_rng((m, k)).uniform(-4, 4, 2) for m, k in zip(member, start, strict=True)]
        return Point(best.T, np.array(draws))


@dataclass
class Waves(Valley):
    """r = [sin(3 x), (x - a) / 4, (y - a) / 4]: many valleys, the deepest at a = 0."""

    def residual(self, member: np.ndarray, q: np.ndarray) -> np.ndarray:
        a = self.a[member]
        return np.stack([np.sin(3.0 * (q[:, 0] - a)), 0.25 * (q[:, 0] - a), 0.25 * (q[:, 1] - a)], axis=1)

    def jacobian(self, member: np.ndarray, q: np.ndarray) -> np.ndarray:
        slope, zero, quarter = 3.0 * np.cos(3.0 * (q[:, 0] - self.a[member])), np.zeros(len(q)), np.full(len(q), 0.25)
        return np.stack([slope, zero, quarter, zero, zero, quarter], axis=1).reshape(-1, 3, 2)


def start_of(count: int, seed: int = 0, spread: float = 2.0) -> Point:
    T = np.random.default_rng(seed + 100).normal(size=(count, 4, 4))
    return Point(T, spread * np.random.default_rng(seed).normal(size=(count, 2)))


def equal(one: Minimum, other: Minimum, rows: np.ndarray | slice = slice(None), own: np.ndarray | slice = slice(None)):
    """Rows of one result are the rows `own` of the other, to the last bit."""
    for name in ("loss", "status", "iterations", "queries"):
        np.testing.assert_array_equal(getattr(one, name)[rows], getattr(other, name)[own], err_msg=name)
    np.testing.assert_array_equal(one.point.q[rows], other.point.q[own])


# ends


def test_the_bottom_of_a_curved_valley_is_found() -> None:
    problem, start = Valley(np.linspace(-2, 2, 9)), start_of(9)
    # The valley is narrow; a dozen iterations may pass on the way without a fall by 30 %.
    found = minimise(problem, start, replace(SOLVER, last_patience=40), 1e-20)
    assert (found.status == Status.CONVERGED).all() and (found.loss[:, 1] < 1e-20).all()
    np.testing.assert_allclose(found.point.q, np.stack([problem.a, problem.a**2], axis=1), atol=1e-8)
    np.testing.assert_allclose(found.loss[:, 0], (problem.residual(np.arange(9), start.q) ** 2).sum(axis=1))
    np.testing.assert_array_equal(found.point.T, start.T)
    assert found.iterations.max() < 60


def test_what_cannot_be_lowered_further_has_stalled_at_its_true_minimum() -> None:
    found = minimise(Valley(np.linspace(-1, 1, 5), rest=0.3), start_of(5), SOLVER, 1e-10)
    assert (found.status == Status.STALLED).all()
    np.testing.assert_allclose(found.loss[:, 1], 0.09, rtol=1e-6)


def test_the_budget_is_kept_to_the_iteration() -> None:
    problem = Valley(np.linspace(-1, 1, 5))
    found = minimise(problem, start_of(5), replace(SOLVER, iterations=4), 1e-20)
    assert (found.status == Status.BUDGET).all() and (found.iterations == 4).all()
    assert all(len(problem.seen[m]) == 4 for m in range(5))
    np.testing.assert_array_equal(found.queries, 4 * (2 + np.arange(5) % 3))
    # Converging with the last iteration is converging.
    enough = minimise(Valley(np.linspace(-1, 1, 5)), start_of(5), SOLVER, 1e-20).iterations
    exact = minimise(Valley(np.linspace(-1, 1, 5)), start_of(5), replace(SOLVER, iterations=int(enough.max())), 1e-20)
    assert (exact.status == Status.CONVERGED).all()


def test_a_budget_of_time_ends_members_with_the_best_they_had() -> None:
    """Each has its own; of those that have none left only the start is evaluated, and their best counts."""
    problem, start = Valley(np.linspace(-1, 1, 5)), start_of(5)
    seconds = np.array([np.inf, 0.0, np.inf, 0.0, 1e3])
    found, free = (minimise(problem, start, SOLVER, 1e-20, seconds=most) for most in (seconds, np.inf))
    done = np.isposinf(seconds) | (seconds > 1.0)
    equal(found, free, done, done)
    assert (found.status[~done] == Status.BUDGET).all() and (found.iterations[~done] <= 2).all()
    assert (found.loss[:, 1] <= found.loss[:, 0]).all() and np.isfinite(found.loss).all()
    none = minimise(problem, start, SOLVER, 1e-20, seconds=0.0)
    assert (none.status == Status.BUDGET).all()


def test_members_with_another_status_are_not_touched() -> None:
    problem, start = Valley(np.linspace(-1, 1, 4)), start_of(4)
    status = np.array([Status.RUNNING, Status.NO_TARGET, Status.RUNNING, Status.NOT_FINITE])
    given = status.copy()
    found = minimise(problem, start, SOLVER, 1e-20, status=given)
    np.testing.assert_array_equal(given, status)
    np.testing.assert_array_equal(
        found.status, [Status.CONVERGED, Status.NO_TARGET, Status.CONVERGED, Status.NOT_FINITE]
    )
    assert set(problem.seen) == {0, 2}
    np.testing.assert_array_equal(found.point.q[[1, 3]], start.q[[1, 3]])
    assert not found.iterations[[1, 3]].any() and np.isnan(found.loss[[1, 3], 0]).all()


# true losses


def test_points_from_which_steps_are_taken_fall_and_the_best_is_returned() -> None:
    problem = Valley(np.linspace(-2, 2, 9))
    found = minimise(problem, start_of(9), SOLVER, 1e-20)
    rejected = 0
    for m in range(9):
        losses = [loss for _, loss in problem.taken[m]]
        assert (np.diff(losses) <= 0).all()
        rejected += (np.diff(losses) == 0).sum()
        best, loss = min(problem.seen[m], key=lambda seen: seen[1])
        assert found.loss[m, 1] == loss
        np.testing.assert_array_equal(found.point.q[m], best)
    assert rejected > 0, "some trials were worse"


def test_with_restarts_the_loss_falls_within_each_start_and_the_best_of_all_is_kept() -> None:
    problem = Waves(np.zeros(12))
    found = minimise(problem, start_of(12, spread=3.0), replace(SOLVER, restarts=6, iterations=300), 1e-16)
    worse = 0
    for m in range(12):
        losses = [loss for _, loss in problem.seen[m]]
        assert found.loss[m, 1] == min(losses)
        worse += losses[-1] > min(losses)
        np.testing.assert_array_equal(found.point.q[m], min(problem.seen[m], key=lambda seen: seen[1])[0])
    once = minimise(Waves(np.zeros(12)), start_of(12, spread=3.0), SOLVER, 1e-16)
    assert (once.status == Status.CONVERGED).sum() < (found.status == Status.CONVERGED).sum()
    assert (found.loss[:, 1] <= once.loss[:, 1]).all() and (found.iterations >= once.iterations).all()


def test_a_stalled_member_that_is_good_enough_does_not_start_again() -> None:
    for good, expected in ((0.1, False), (0.01, True)):
        problem = Valley(np.zeros(3), rest=0.3)
        problem.rest = np.sqrt(0.05)
        found = minimise(problem, start_of(3), replace(SOLVER, restarts=2, good=good), 1e-20)
        once = minimise(Valley(np.zeros(3), rest=problem.rest), start_of(3), SOLVER, 1e-20)
        assert (found.status == Status.STALLED).all()
        assert bool((found.iterations > once.iterations).all()) == expected


class Level(Valley):
    """Losses that are the same everywhere."""

    def residual(self, member: np.ndarray, q: np.ndarray) -> np.ndarray:
        return np.full((len(q), 1), self.rest)

    def jacobian(self, member: np.ndarray, q: np.ndarray) -> np.ndarray:
        return np.zeros((len(q), 1, 2))

    def restart(self, member: np.ndarray, start: np.ndarray, best: Point, now: Point) -> Point:
        self.widths[-1].extend(start.tolist())
        return super().restart(member, start, best, now)


@pytest.mark.parametrize(("restarts", "budget"), [(0, 99), (2, 99), (2, 12)])
def test_members_that_gain_nothing_restart_as_often_and_as_late_as_the_settings_say(restarts: int, budget: int) -> None:
    """A start is evaluated, then as many trials as the patience; without another restart, as the last patience."""
    solver = LevenbergMarquardt(iterations=budget, restarts=restarts, patience=3, last_patience=5)
    problem = Level(np.zeros(1), rest=0.3)
    found = minimise(problem, start_of(1), solver, 1e-20)
    assert found.iterations[0] == min(restarts * (1 + 3) + 1 + 5, budget)
    assert problem.widths[-1] == list(range(1, restarts + 1))
    assert found.status[0] == Status.STALLED
    # So does a damping beyond the largest: 0.01 grows by 4 with each of four trials.
    damped = replace(solver, largest=1.0, restarts=0, patience=50, last_patience=50, iterations=99)
    assert minimise(Level(np.zeros(1), rest=0.3), start_of(1), damped, 1e-20).iterations[0] == 1 + 4


class Stairs(Level):
    """Levels whose losses fall where a member starts for the third time, by the share `fall`."""

    fall = 0.5

    def residual(self, member: np.ndarray, q: np.ndarray) -> np.ndarray:
        return self.rest * np.sqrt(np.where(q[:, :1] > 99.0, 1.0 - self.fall, 1.0))

    def restart(self, member: np.ndarray, start: np.ndarray, best: Point, now: Point) -> Point:
        super().restart(member, start, best, now)
        return Point(best.T, np.where(start[:, None] >= 3, 100.0, 0.0) + np.zeros((len(member), 2)))


@pytest.mark.parametrize(("fall", "starts"), [(0.0, 4), (0.05, 4), (0.5, 3 + 4)])
def test_a_member_ends_after_enough_starts_that_end_alike_counted_anew_from_a_lower_loss(
    fall: float, starts: int
) -> None:
    solver = LevenbergMarquardt(iterations=500, restarts=99, patience=3, last_patience=5, agreeing=4)
    problem = Stairs(np.zeros(1), rest=0.3)
    problem.fall = fall
    found = minimise(problem, start_of(1, spread=0.0), solver, 1e-20)
    assert found.iterations[0] == starts * (1 + 3) + 1 + 5
    assert found.status[0] == Status.STALLED
    assert found.loss[0, 1] == pytest.approx(0.09 * (1.0 - fall))


def test_neighbourhoods_change_with_every_rejection_and_only_then() -> None:
    problem = Valley(np.linspace(-2, 2, 5))
    minimise(problem, start_of(5), SOLVER, 1e-20)
    cycle = SOLVER.widths
    changed = 0
    for m in range(5):
        assert problem.widths[m][0] == cycle[0]
        place = 0
        for (one, _), (two, _), width in zip(
            problem.taken[m], problem.taken[m][1:], problem.widths[m][1:], strict=False
        ):
            place += bool((one == two).all())
            assert width == cycle[place % len(cycle)]
        changed += place
    assert changed > 3


# members on their own


@pytest.mark.parametrize("width", [1, 3, 5, 64])
def test_a_member_does_not_depend_on_who_else_is_there_nor_on_their_number(width: int) -> None:
    """Slots are refilled in the middle of it all; random numbers are those of the member."""
    a, start = np.linspace(-0.5, 0.5, 20), start_of(20, 3, spread=3.0)
    solver = replace(SOLVER, restarts=4, iterations=120)
    problem = Waves(a)
    together = minimise(problem, start, solver, 1e-16)
    assert problem.most == 20 and len(np.unique(together.iterations)) > 3
    narrow = Waves(a, width=width)
    found = minimise(narrow, start, solver, 1e-16)
    equal(found, together)
    assert narrow.most == min(width, 20)
    assert len({*together.status}) > 1


class Spoilt(Waves):
    """Some members have no loss at all, and some only in places."""

    def evaluate(self, member: np.ndarray, point: Point, previous: Known | None) -> Known:
        known = super().evaluate(member, point, previous)
        never, here = member == 3, (member == 5) & (point.q[:, 0] > 1.0)
        return replace(known, loss=np.where(never | here, np.nan, known.loss))


@pytest.mark.parametrize("width", [4, 64])
def test_one_bad_member_changes_nothing_for_the_others(width: int) -> None:
    a, start = np.zeros(8), start_of(8, 5)
    start.q[3], start.q[5] = np.nan, [0.95, 0.3]
    solver = replace(SOLVER, restarts=4)
    found, clean = (minimise(of(a, width=width), start, solver, 1e-16) for of in (Spoilt, Waves))
    others = np.array([0, 1, 2, 4, 6, 7])
    equal(found, clean, others, others)
    assert found.status[3] == Status.NOT_FINITE and found.iterations[3] == 1
    assert np.isnan(found.loss[3, 0]) and np.isnan(found.point.q[3]).all()
    # Trials without an answer are rejected, and others tried.
    assert np.isfinite(found.loss[5]).all() and found.loss[5, 1] < found.loss[5, 0]


# accounts


def test_progress_counts_the_finished_and_the_costs_are_shared_out() -> None:
    said: list[tuple[int, int, float]] = []
    status = np.full(9, Status.RUNNING)
    status[4] = Status.NO_TARGET
    found = minimise(
        Valley(np.linspace(-2, 2, 9), width=3), start_of(9), SOLVER, 1e-20, status=status,
        progress=lambda *now: said.append(now),
    )  # fmt: skip
    done, iterations, loss = (np.array(column) for column in zip(*said, strict=True))
    assert done[0] >= 1 and done[-1] == 9 and (np.diff(done) >= 0).all()
    np.testing.assert_array_equal(iterations, np.arange(1, len(said) + 1))
    assert np.isfinite(loss).all() and loss[0] > loss[-1] >= 0
    ran = status == Status.RUNNING
    assert (found.wall_s[ran] > 0).all() and (found.cpu_s[ran] >= 0).all()
    assert not found.wall_s[~ran].any() and not found.cpu_s[~ran].any()
