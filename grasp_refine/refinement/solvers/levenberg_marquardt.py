"""Levenberg-Marquardt: damped Gauss-Newton steps within bounds, accepted only where the true loss falls."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

import numpy as np

from grasp_refine.core.arguments import check_fields
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.refinement.solvers.bounded_step import bounded_step
from grasp_refine.refinement.solvers.iterate import Point, Record, Slots
from grasp_refine.refinement.solvers.rows import Linear
from grasp_refine.refinement.solvers.status import Status


@runtime_checkable
class LeastSquares(Protocol):
    """Requirements of Levenberg-Marquardt on a problem, beside its evaluation."""

    restarts: bool
    """Whether a stalled member may start elsewhere."""

    def linearize(self, member: np.ndarray, point: Point, known: Any, width: np.ndarray) -> Linear:
        """Return residuals and derivatives; `width` (batch,) multiplies the radii of neighbourhoods."""
        ...

    def metric(self, member: np.ndarray) -> np.ndarray:
        """Return the diagonals of W (batch, dof): the squared movement of a unit of each unknown."""
        ...

    def step_bounds(self, member: np.ndarray, point: Point) -> tuple[np.ndarray, np.ndarray]:
        """Return lower and upper bounds of a step (batch, dof)."""
        ...

    def integrate(self, member: np.ndarray, point: Point, dx: np.ndarray) -> Point:
        """Return the points after steps (batch, dof)."""
        ...


@dataclass(frozen=True, eq=False)
class Damping:
    """State of the solver (batch,)."""

    damping: np.ndarray
    """Damping lambda."""
    rejections: np.ndarray
    """Rejected trials of this start."""
    predicted: np.ndarray
    """Predicted fall of the loss at the trial."""


@dataclass(frozen=True)
class LevenbergMarquardt:
    """Damped Gauss-Newton steps (Levenberg 1944, Marquardt 1963) for a sum of squared residuals r(x).

    A step solves (J^T J + lambda W) dx = -J^T r within bounds on dx, W the metric of the unknowns, so that lambda
    compares with the squared derivative of a residual. Penetrations count from where they begin, within a step too.
    It is accepted where the loss |r|^2, evaluated anew, falls; then, if the fall is as predicted, lambda shrinks.
    Where it is rejected lambda grows, and the derivative is taken again with another width of the neighbourhoods. A
    member that stalls restarts elsewhere.
    """

    needs_autograd: ClassVar[Literal[False]] = False

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
    """Iterations without progress after which a member that cannot restart, or is good enough, ends.

    While forces are balanced in the search for force closure it is at most 8."""
    progress: float = 0.3
    """Smallest relative fall of the loss that counts as progress."""
    restarts: int = 20
    """Number of restarts of a stalled grasp with given targets, from its own random numbers."""
    agreeing: int = 50
    """Starts that end within a tenth of the best loss after which a member ends: other starts lead there again."""
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

    def start(self, problem: LeastSquares, point: Point) -> tuple[Point, Damping]:
        """Return the points themselves, and the initial state."""
        count = len(point.T)
        return point, Damping(np.full(count, self.damping), np.zeros(count, dtype=np.int64), np.zeros(count))

    def accept(self, slots: Slots, known: Any) -> tuple[np.ndarray, Damping]:
        """Return which trials are accepted, because their loss fell, and the state with their new lambda."""
        starting, state = np.isinf(slots.loss), slots.state
        accepted = known.loss < slots.loss
        fall = np.where(starting, 0.0, slots.loss) - known.loss
        # A start has no prediction; a floor at the smallest number would overflow.
        ratio = fall / np.maximum(state.predicted, 1e-200)
        damping = np.where(starting, state.damping, self.updated_damping(state.damping, accepted, ratio))
        return accepted, Damping(damping, np.where(starting, 0, state.rejections + ~accepted), state.predicted)

    def assess(self, problem: LeastSquares, slots: Slots, record: Record) -> tuple[Slots, np.ndarray, np.ndarray]:
        """Return the slots, the status of each member, and which should restart."""
        restarts = self.restarts if problem.restarts else 0
        more = (slots.starts <= restarts) & (record.best_loss >= self.good) & (record.agreeing < self.agreeing)
        patience = np.where(more, self.patience, self.last_patience)
        stuck = (slots.since >= patience) | (slots.state.damping > self.largest) | np.isinf(slots.loss)
        stalled = (stuck & ~more) | (record.spent & (record.idle >= self.last_patience))
        return slots, np.where(stalled, Status.STALLED, Status.RUNNING), stuck & more

    def step(self, problem: LeastSquares, slots: Slots) -> tuple[Point, Damping]:
        """Return the points after damped steps within bounds, and the state with the predicted falls."""
        member, state = slots.member, slots.state
        width = np.array(self.widths)[state.rejections % len(self.widths)]
        linear = problem.linearize(member, slots.point, slots.known, width)
        lower, upper = problem.step_bounds(member, slots.point)
        dx, predicted = bounded_step(
            linear.jacobian, linear.residual, state.damping, problem.metric(member), lower, upper, linear.unilateral
        )
        return problem.integrate(member, slots.point, dx), replace(state, predicted=predicted)

    def updated_damping(self, damping: np.ndarray, accepted: np.ndarray, ratio: np.ndarray) -> np.ndarray:
        """Return lambda (batch,) after a step, given acceptance and the ratio of its fall to the predicted one."""
        shrunk = np.where(ratio > self.gain, self.shrink * damping, damping)
        return np.where(accepted, np.maximum(shrunk, self.smallest), self.grow * damping)
