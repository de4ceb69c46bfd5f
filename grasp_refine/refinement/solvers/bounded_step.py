"""Steps of damped least squares within bounds, with rows that count only where they are positive."""

from contextlib import suppress

import numpy as np

from grasp_refine.collision.engine import chosen
from grasp_refine.core.se3 import matvec


def bounded_step(
    J: np.ndarray,
    r: np.ndarray,
    damping: np.ndarray,
    metric: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    unilateral: np.ndarray | None = None,
    passes: int = 4,
) -> tuple[np.ndarray, np.ndarray]:
    """Return steps dx (batch, n) within bounds, and the falls (batch,) of the loss that they predict.

    Unilateral rows count only where they are positive. Which of them will be after the step is found by
    solving again with the active set of the last solution (semismooth Newton), so that a step neither runs into what
    is near nor is held back by what it leaves. `collision/native/bounded_step.h` does the same, compiled.

    Args:
        J: Jacobians (batch, m, n).
        r: Residuals (batch, m).
        damping: lambda (batch,).
        metric: Diagonals of W (batch, n).
        lower: Lower bounds of dx (batch, n), at most 0.
        upper: Upper bounds, at least 0.
        unilateral: Rows (batch, m) that count only where they are positive; None: none.
        passes: Largest number of passes that choose the active rows and bounds.
    """
    if chosen("auto") == "native":
        from grasp_refine.collision.native_search import bounded_steps

        return bounded_steps(J, r, damping, metric, lower, upper, unilateral=unilateral, passes=passes)
    if unilateral is None:
        dx = _solve_within_bounds(J, r, damping, metric, lower, upper)
        after = r + matvec(J, dx)
        return dx, np.sum(r * r - after * after, axis=-1)
    counts = ~unilateral | (r > 0)
    before = np.where(counts, r, np.zeros_like(r))
    dx = np.zeros_like(lower)
    some = np.ones_like(damping, dtype=bool)
    for _ in range(passes):
        counted = np.where(counts[some][..., None], J[some], 0.0)
        dx[some] = _solve_within_bounds(counted, r[some], damping[some], metric[some], lower[some], upper[some])
        after = r + matvec(J, dx)
        now = ~unilateral | (after > 0)
        some = np.any(now != counts, axis=-1)
        counts = now
        if not some.any():
            break
    after = np.where(counts, after, np.zeros_like(after))
    return dx, np.sum(before * before - after * after, axis=-1)


def _solve_within_bounds(
    J: np.ndarray,
    r: np.ndarray,
    damping: np.ndarray,
    metric: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    passes: int = 10,
) -> np.ndarray:
    """Return steps dx (batch, n) within bounds that minimise |J dx + r|^2 + lambda dx . W dx.

    A primal-dual active-set method (Hintermueller, Ito and Kunisch 2003): unknowns that go beyond a bound are held
    there, held unknowns that would come back are released, and the others are solved for again. That mostly settles
    within five passes. It may cycle, though: the last three passes release nothing, and unknowns that are still
    outside then are clipped.
    """
    J_transposed = J.mT
    damped, g = J_transposed @ J + _diagonal(damping[:, None] * metric), matvec(J_transposed, r)
    dx = _solve(damped, -g)
    if not ((dx < lower) | (dx > upper)).any():
        return dx
    held = np.zeros_like(dx, dtype=bool)
    for number in range(passes - 1):
        kept = held if number > passes - 4 else np.zeros_like(held)
        # A held unknown is released if the slope points back into its bounds.
        slope = np.where(held & ~kept, matvec(damped, dx) + g, np.zeros_like(dx))
        wanted = dx - slope / np.linalg.diagonal(damped)
        limited = np.minimum(np.maximum(wanted, lower), upper)
        outside = (limited != wanted) | kept
        (rows,) = np.nonzero(np.any((outside != held) | (outside & (limited != dx)), axis=-1))
        if not len(rows):
            break
        held = outside
        dx[rows] = _solve_free(damped[rows], g[rows], held[rows], limited[rows])
    return np.minimum(np.maximum(dx, lower), upper)


def _solve_free(damped: np.ndarray, g: np.ndarray, held: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return solutions (batch, n) of damped dx = -g in the free unknowns, the held ones fixed at a value."""
    fixed = np.where(held, np.ones_like(value), np.zeros_like(value))
    free, value = 1.0 - fixed, fixed * value
    # Held unknowns move to the right-hand side; its own rows become rows of the unit matrix.
    right = free * (-g - matvec(damped, value)) + value
    system = damped * free[:, :, None] * free[:, None, :] + _diagonal(fixed)
    return np.where(held, value, _solve(system, right))


def _solve(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return solutions (batch, n) of A x = b; zero, which is no step, for a matrix that rounding has made singular."""
    try:
        return np.linalg.solve(A, b[..., None])[..., 0]
    except np.linalg.LinAlgError:
        found = np.zeros_like(b)
        for row in range(len(A)):
            with suppress(np.linalg.LinAlgError):
                found[row] = np.linalg.solve(A[row], b[row])
        return found


def _diagonal(values: np.ndarray) -> np.ndarray:
    """Return diagonal matrices (batch, n, n) of values (batch, n)."""
    n = values.shape[-1]
    result = np.zeros_like(values[:, :, None] + values[:, None, :])
    result[:, range(n), range(n)] = values
    return result
