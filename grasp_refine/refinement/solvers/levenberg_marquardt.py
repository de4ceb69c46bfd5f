"""Levenberg-Marquardt: damped Gauss-Newton steps within bounds, accepted only where the true loss falls."""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from grasp_refine.core.arguments import check_fields
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import Array, array_namespace, matvec


@dataclass(frozen=True)
class LevenbergMarquardt:
    """Damped Gauss-Newton steps (Levenberg 1944, Marquardt 1963) for a sum of squared residuals r(x).

    A step solves (J^T J + lambda W) dx = -J^T r within bounds on dx, W the metric of the unknowns, so that lambda
    compares with the squared derivative of a residual. Penetrations count from where they begin, within a step too.
    It is accepted where the loss |r|^2, evaluated anew, falls; then, if the fall is as predicted, lambda shrinks.
    Where it is rejected lambda grows, and the derivative is taken again with another width of the neighbourhoods. A
    member that stalls restarts elsewhere.
    """

    iterations: int = 200
    """Largest number of iterations per grasp, each one collision query."""
    damping: float = 1e-2
    """Initial damping lambda."""
    smallest: float = 1e-7
    """Lower bound of lambda."""
    largest: float = 1e8
    """Largest lambda; a member whose lambda grows beyond it stalls."""
    shrink: float = 0.3
    """Factor of lambda after a step whose loss fell as predicted."""
    grow: float = 4.0
    """Factor of lambda after a rejected step."""
    gain: float = 0.25
    """Smallest share of the predicted fall of the loss that counts as predicted."""
    patience: int = 6
    """Iterations without progress after which a member restarts."""
    last_patience: int = 12
    """Iterations without progress after which a member that cannot restart, or is good enough, ends."""
    progress: float = 0.3
    """Smallest relative fall of the loss that counts as progress."""
    restarts: int = 20
    """Number of restarts of a stalled grasp with given targets, from its own random numbers."""
    good: float = 1e-7
    """Best loss (m^2) below which a member does not restart; 1e-7 is a third of a millimetre."""
    widths: tuple[float, ...] = (1.0, 0.5, 2.0, 0.0)
    """Factors of the radii of the smoothing neighbourhoods, the next one after each rejection; 0: no smoothing."""

    def __post_init__(self) -> None:
        """Refuse settings with which lambda would vanish, stay constant, or change the wrong way.

        Raises:
            GraspRefineError: names the setting, its value and its range.
        """
        check_fields(self)
        if self.iterations < 0:
            raise GraspRefineError(f"levenberg-marquardt: iterations must be at least 0, got {self.iterations}")
        for name in ("damping", "smallest"):
            if not getattr(self, name) > 0.0:
                raise GraspRefineError(f"levenberg-marquardt: {name} must be above 0, got {getattr(self, name):g}")
        if not 0.0 < self.progress < 1.0:
            raise GraspRefineError(f"levenberg-marquardt: progress must be in (0, 1), got {self.progress:g}")
        if not self.widths:
            raise GraspRefineError("levenberg-marquardt: widths needs at least one factor")
        if not 0.0 < self.shrink < 1.0 < self.grow:
            raise GraspRefineError(
                f"levenberg-marquardt: shrink must be in (0, 1) and grow above 1, got {self.shrink:g} and {self.grow:g}"
            )

    def updated_damping(self, damping: Array, accepted: Array, ratio: Array) -> Array:
        """Return lambda (batch,) after a step, given acceptance and the ratio of its fall to the predicted one."""
        xp = array_namespace(damping)
        shrunk = xp.where(ratio > self.gain, self.shrink * damping, damping)
        return xp.where(accepted, xp.maximum(shrunk, xp.full_like(damping, self.smallest)), self.grow * damping)


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
