"""Steps of damped least squares within bounds, with rows that count only where they are positive."""

from contextlib import suppress

import numpy as np

from grasp_refine.core.se3 import Array, array_namespace, matvec


def bounded_step(
    J: Array,
    r: Array,
    damping: Array,
    metric: Array,
    lower: Array,
    upper: Array,
    unilateral: Array | None = None,
    passes: int = 4,
) -> tuple[Array, Array]:
    """Return steps dx (batch, n) within bounds, and the falls (batch,) of the loss that they predict.

    Unilateral rows count only where they are positive. Which of them will be after the step is found by
    solving again with those that the last solution made so (semismooth Newton), so that a step neither runs into what
    is near nor is held back by what it leaves.

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
    xp = array_namespace(J)
    if unilateral is None:
        dx = _solve_within_bounds(J, r, damping, metric, lower, upper)
        after = r + matvec(J, dx)
        return dx, xp.sum(r * r - after * after, axis=-1)
    counts = ~unilateral | (r > 0)
    before = xp.where(counts, r, xp.zeros_like(r))
    dx = xp.zeros_like(lower)
    some = xp.ones_like(damping, dtype=xp.bool)
    for _ in range(passes):
        counted = xp.where(counts[some][..., None], J[some], 0.0)
        dx[some] = _solve_within_bounds(counted, r[some], damping[some], metric[some], lower[some], upper[some])
        after = r + matvec(J, dx)
        now = ~unilateral | (after > 0)
        some = xp.any(now != counts, axis=-1)
        counts = now
        if not bool(xp.any(some)):
            break
    after = xp.where(counts, after, xp.zeros_like(after))
    return dx, xp.sum(before * before - after * after, axis=-1)


def _solve_within_bounds(
    J: Array, r: Array, damping: Array, metric: Array, lower: Array, upper: Array, passes: int = 10
) -> Array:
    """Return steps dx (batch, n) within bounds that minimise |J dx + r|^2 + lambda dx . W dx.

    A primal-dual active-set method (Hintermueller, Ito and Kunisch 2003): unknowns that go beyond a bound are held
    there, held ones that would come back are released, and the others are solved for again. That mostly settles
    within five passes. It may cycle, though: the last three passes release nothing, and unknowns that are still
    outside then are clipped.
    """
    xp = array_namespace(J)
    J_transposed = xp.matrix_transpose(J)
    damped, g = J_transposed @ J + _diagonal(damping[:, None] * metric), matvec(J_transposed, r)
    dx = _solve(damped, -g)
    if not bool(xp.any((dx < lower) | (dx > upper))):
        return dx
    held = xp.zeros_like(dx, dtype=xp.bool)
    for number in range(passes - 1):
        kept = held if number > passes - 4 else xp.zeros_like(held)
        # A held unknown is released if the slope points back into its bounds.
        slope = xp.where(held & ~kept, matvec(damped, dx) + g, xp.zeros_like(dx))
        wanted = dx - slope / xp.linalg.diagonal(damped)
        limited = xp.minimum(xp.maximum(wanted, lower), upper)
        outside = (limited != wanted) | kept
        (rows,) = xp.nonzero(xp.any((outside != held) | (outside & (limited != dx)), axis=-1))
        if not len(rows):
            break
        held = outside
        dx[rows] = _solve_free(damped[rows], g[rows], held[rows], limited[rows])
    return xp.minimum(xp.maximum(dx, lower), upper)


def _solve_free(damped: Array, g: Array, held: Array, value: Array) -> Array:
    """Return solutions (batch, n) of damped dx = -g in the free unknowns, the held ones fixed at a value."""
    xp = array_namespace(damped)
    fixed = xp.where(held, xp.ones_like(value), xp.zeros_like(value))
    free, value = 1.0 - fixed, fixed * value
    # Held unknowns move to the right-hand side; its own rows become those of the unit matrix.
    right = free * (-g - matvec(damped, value)) + value
    system = damped * free[:, :, None] * free[:, None, :] + _diagonal(fixed)
    return xp.where(held, value, _solve(system, right))


def _solve(A: Array, b: Array) -> Array:
    """Return solutions (batch, n) of A x = b; zero, which is no step, for a matrix that rounding has made singular."""
    xp = array_namespace(A)
    try:
        return xp.linalg.solve(A, b[..., None])[..., 0]
    except np.linalg.LinAlgError:
        found = xp.zeros_like(b)
        for row in range(len(A)):
            with suppress(np.linalg.LinAlgError):
                found[row] = xp.linalg.solve(A[row], b[row])
        return found


def _diagonal(values: Array) -> Array:
    """Return diagonal matrices (batch, n, n) of values (batch, n)."""
    xp = array_namespace(values)
    n = values.shape[-1]
    result = xp.zeros_like(values[:, :, None] + values[:, None, :])
    result[:, range(n), range(n)] = values
    return result
