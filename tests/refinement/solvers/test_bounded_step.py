"""Steps within bounds against scipy and closed forms; how lambda moves."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from grasp_refine.collision.engine import engines
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.refinement.solvers.bounded_step import bounded_step
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from refusals import refused


def problems(count: int, m: int, n: int, seed: int) -> tuple[np.ndarray, ...]:
    """J, r, lambda and W."""
    rng = np.random.default_rng(seed)
    J, r = rng.normal(size=(count, m, n)), rng.normal(size=(count, m))
    return J, r, 10.0 ** rng.uniform(-4, 1, count), rng.uniform(0.2, 2.0, (count, n))


def damped_loss(J: np.ndarray, r: np.ndarray, damping: np.ndarray, metric: np.ndarray, dx: np.ndarray) -> np.ndarray:
    """|J dx + r|^2 + lambda dx . W dx, which a step minimises within its bounds."""
    left = np.einsum("bij,bj->bi", J, dx) + r
    return (left**2).sum(axis=1) + damping * (metric * dx * dx).sum(axis=1)


def optimum(
    J: np.ndarray, r: np.ndarray, damping: np.ndarray, metric: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> np.ndarray:
    """The same by scipy, one after the other; variables without room are taken out."""
    rows = []
    for i in range(len(r)):
        room = upper[i] > lower[i]
        A = np.concatenate([J[i], np.diag(np.sqrt(damping[i] * metric[i]))])[:, room]
        b = np.concatenate([-r[i], np.zeros(len(room))])
        dx = np.zeros(len(room))
        if room.any():
            dx[room] = lsq_linear(A, b, (lower[i][room], upper[i][room]), tol=1e-14, method="bvls").x
        rows.append(dx)
    return np.array(rows)


FREE = 1e9


@pytest.mark.parametrize("m", [3, 8, 20])
def test_without_active_bounds_steps_are_as_in_the_normal_equations(m: int) -> None:
    J, r, damping, metric = problems(20, m, 6, 0)
    dx, fall = bounded_step(J, r, damping, metric, np.full((20, 6), -FREE), np.full((20, 6), FREE))
    for i in range(20):
        expected = np.linalg.solve(J[i].T @ J[i] + damping[i] * np.diag(metric[i]), -J[i].T @ r[i])
        np.testing.assert_allclose(dx[i], expected, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(
        dx, optimum(J, r, damping, metric, *np.full((2, 20, 6), FREE) * [[[-1]], [[1]]]), atol=1e-8
    )


def test_with_active_bounds_steps_are_the_optimum_within_them() -> None:
    """Held unknowns are released again: without that, two of three steps were not the best, and some went uphill."""
    J, r, damping, metric = problems(300, 12, 6, 1)
    rng = np.random.default_rng(2)
    lower, upper = -rng.uniform(0, 0.3, (300, 6)), rng.uniform(0, 0.3, (300, 6))
    dx, fall = bounded_step(J, r, damping, metric, lower, upper)
    assert (dx >= lower).all() and (dx <= upper).all()
    best = optimum(J, r, damping, metric, lower, upper)
    held = ((best == lower) | (best == upper)).sum(axis=1)
    assert held.min() == 0 and held.max() >= 5
    start = (r**2).sum(axis=1)
    won, possible = start - damped_loss(J, r, damping, metric, dx), start - damped_loss(J, r, damping, metric, best)
    assert (won <= possible * (1 + 1e-9)).all()
    np.testing.assert_allclose(won, possible, rtol=1e-9)
    np.testing.assert_allclose(dx, best, atol=1e-6)
    assert (fall > 0).all()


def test_steps_that_do_not_settle_keep_to_their_bounds() -> None:
    """Hardly damped, with far more unknowns than residuals, about one active set in ten goes round in circles."""
    J, r, damping, metric = problems(200, 10, 28, 17)
    rng = np.random.default_rng(18)
    lower, upper = -rng.uniform(0, 0.3, (200, 28)), rng.uniform(0, 0.3, (200, 28))
    dx, _ = bounded_step(J, r, 1e-6 * damping, metric, lower, upper)
    assert (dx >= lower).all() and (dx <= upper).all()


def test_a_held_unknown_changes_what_the_others_do() -> None:
    """r = [x + y - 2, y]: at x <= 0.5 the best y is 0.75, not the 0 that cutting off the free step would leave."""
    J, r = np.array([[[1.0, 1.0], [0.0, 1.0]]]), np.array([[-2.0, 0.0]])
    dx, fall = bounded_step(J, r, np.zeros(1), np.ones((1, 2)), np.full((1, 2), -9.0), np.array([[0.5, 9.0]]))
    np.testing.assert_allclose(dx, [[0.5, 0.75]], atol=1e-12)
    assert fall[0] == pytest.approx(4.0 - 0.75**2 - 0.75**2)


# one-sided rows


def one_sided_problems(count: int, seed: int) -> tuple[np.ndarray, ...]:
    """J, r, lambda, W and which rows are one-sided: half of them, some positive at first."""
    J, r, damping, metric = problems(count, 14, 6, seed)
    unilateral = np.tile(np.arange(14) % 2 == 0, (count, 1))
    return J, r, damping, metric, unilateral


def one_sided_loss(J: np.ndarray, r: np.ndarray, unilateral: np.ndarray, dx: np.ndarray) -> np.ndarray:
    after = r + np.einsum("bij,bj->bi", J, dx)
    return (np.where(unilateral, np.maximum(after, 0.0), after) ** 2).sum(axis=1)


def test_one_sided_rows_count_where_they_are_positive_after_the_step() -> None:
    """r = [x - 1, 3 (x - 0.5)+]: neither 1, as if it were free, nor 0.55, as if it pulled from below as well."""
    J, damping = np.array([[[1.0], [3.0]]]), np.zeros(1)
    bounds = np.full((1, 1), -9.0), np.full((1, 1), 9.0)
    unilateral = np.array([[False, True]])
    dx, fall = bounded_step(J, np.array([[-1.0, -1.5]]), damping, np.ones((1, 1)), *bounds, unilateral)
    np.testing.assert_allclose(dx, [[0.55]], atol=1e-12)
    assert fall[0] == pytest.approx(1.0 - 0.45**2 - 0.15**2)
    # r = [x + 1, 3 (x + 0.1)+]: what a step leaves does not hold it back nor push it on.
    dx, fall = bounded_step(J, np.array([[1.0, 0.3]]), damping, np.ones((1, 1)), *bounds, unilateral)
    np.testing.assert_allclose(dx, [[-1.0]], atol=1e-12)
    assert fall[0] == pytest.approx(1.09)


@pytest.mark.parametrize("room", [FREE, 0.3])
def test_steps_with_one_sided_rows_are_the_optimum_and_foretell_the_fall(room: float) -> None:
    """The damped loss is convex and piecewise quadratic: at its minimum no way within the bounds leads down."""
    J, r, damping, metric, unilateral = one_sided_problems(200, 14)
    rng = np.random.default_rng(15)
    lower, upper = -room * rng.uniform(0.1, 1, (200, 6)), room * rng.uniform(0.1, 1, (200, 6))
    dx, fall = bounded_step(J, r, damping, metric, lower, upper, unilateral)
    assert (dx >= lower).all() and (dx <= upper).all()
    zero = np.zeros_like(dx)
    np.testing.assert_allclose(
        fall, one_sided_loss(J, r, unilateral, zero) - one_sided_loss(J, r, unilateral, dx), rtol=1e-9, atol=1e-12
    )
    after = r + np.einsum("bij,bj->bi", J, dx)
    slope = (
        np.einsum("bij,bi->bj", J, np.where(unilateral, np.maximum(after, 0.0), after)) + damping[:, None] * metric * dx
    )
    free = np.where((dx <= lower) & (slope > 0) | (dx >= upper) & (slope < 0), 0.0, slope)
    settled = np.abs(free).max(axis=1) < 1e-8
    assert settled.mean() > 0.9 and (fall[settled] > 0).all() and (fall > 0).mean() > 0.99


# lambda


def test_lambda_shrinks_after_what_was_predicted_stays_after_less_and_grows_after_a_rejection() -> None:
    solver = LevenbergMarquardt(shrink=0.25, grow=8.0, gain=0.5, smallest=1e-3)
    arrays = (
        np.array([1.0, 1.0, 1.0, 1.0, 2e-3, 1.0]),
        np.array([True, True, False, False, True, False]),
        np.array([0.9, 0.4, -1.0, 0.9, 1.0, np.nan]),
    )
    found = solver.updated_damping(*arrays)
    np.testing.assert_allclose(found, [0.25, 1.0, 8.0, 8.0, 1e-3, 8.0])


@pytest.mark.parametrize(("shrink", "grow"), [(1.0, 4.0), (0.0, 4.0), (0.3, 1.0), (-0.1, 4.0)])
def test_a_lambda_that_would_not_move_is_refused(shrink: float, grow: float) -> None:
    with refused(GraspRefineError, "shrink", "grow", "(0, 1)", f"{shrink:g} and {grow:g}"):
        LevenbergMarquardt(shrink=shrink, grow=grow)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"damping": 0.0}, ("damping", "0")),
        ({"damping": float("nan")}, ("damping", "nan")),
        ({"smallest": -1e-7}, ("smallest", "0", "-1e-07")),
        ({"progress": 0.0}, ("progress", "(0, 1)", " 0")),
        ({"progress": 1.0}, ("progress", "(0, 1)", " 1")),
        ({"widths": ()}, ("widths",)),
    ],
)
def test_settings_that_cannot_work_are_refused(settings: dict[str, object], named: tuple[str, ...]) -> None:
    with refused(GraspRefineError, *named):
        LevenbergMarquardt(**settings)


@pytest.mark.skipif("native" not in engines(), reason="the compiled module is not available")
@pytest.mark.parametrize("one_sided", [False, True])
def test_compiled_steps_are_as_in_the_plain_form(one_sided: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Within bounds that hold most unknowns, some without any room, and with one-sided rows."""
    J, r, damping, metric = problems(400, 14, 7, 11)
    rng = np.random.default_rng(12)
    lower, upper = -rng.exponential(0.1, (400, 7)), rng.exponential(0.1, (400, 7))
    lower[::3, 2] = upper[::3, 2] = 0.0
    unilateral = rng.random((400, 14)) < 0.5 if one_sided else None
    found = []
    for engine in ("native", "python"):
        monkeypatch.setenv("GRASP_REFINE_ENGINE", engine)
        found.append(bounded_step(J, r, damping, metric, lower, upper, unilateral))
    assert ((found[0][0] == lower) | (found[0][0] == upper)).sum() > 400
    for compiled, plain in zip(*found, strict=True):
        np.testing.assert_allclose(compiled, plain, rtol=1e-9, atol=1e-11)


@pytest.mark.skipif("native" not in engines(), reason="the compiled module is not available")
def test_compiled_steps_do_not_depend_on_the_batch_or_the_threads() -> None:
    from grasp_refine.collision.native_search import bounded_steps

    J, r, damping, metric = problems(300, 12, 6, 13)
    lower, upper = np.full((300, 6), -0.1), np.full((300, 6), 0.1)
    unilateral = np.random.default_rng(14).random((300, 12)) < 0.3
    arrays = J, r, damping, metric, lower, upper
    together = bounded_steps(*arrays, unilateral=unilateral, passes=4, threads=2)
    for rows in (slice(17, 18), slice(100, 150)):
        parts = (part[rows] for part in arrays)
        alone = bounded_steps(*parts, unilateral=unilateral[rows], passes=4, threads=1)
        for one, all_of_them in zip(alone, together, strict=True):
            np.testing.assert_array_equal(one, all_of_them[rows])
