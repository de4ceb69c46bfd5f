"""First-order solvers: steps against the gradient, of lengths that shrink."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol, runtime_checkable

import numpy as np

from grasp_refine.core.arguments import check_fields
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import retract
from grasp_refine.refinement.solvers.iterate import Point, Record, Slots
from grasp_refine.refinement.solvers.status import Status

if TYPE_CHECKING:
    # It takes seconds to load, and options are made of this class.
    import torch


@runtime_checkable
class Differentiable(Protocol):
    """Requirements of a first-order solver on a problem, whose evaluations have a `gradient` (batch, 6 + n).

    It is that of the root as a body twist (v, w), then that of the joint values.
    """

    lower: torch.Tensor
    """Lower joint limits (n,), in the number type of the problem and within the true ones."""
    upper: torch.Tensor
    """Upper joint limits (n,), likewise."""
    per_radian: torch.Tensor
    """Movements (n,) of the joints that count as one radian, as `Hand.per_radian`."""

    def tensor(self, array: np.ndarray) -> torch.Tensor:
        """Return an array in the number type and on the device of the problem."""
        ...


@dataclass(frozen=True, eq=False)
class Descending:
    """State of a first-order solver."""

    phase: np.ndarray
    """Phase of the schedule (batch,): the number of factors that have had their turn."""
    memory: np.ndarray
    """Averages that the solver keeps (batch, m)."""


@dataclass(frozen=True)
class FirstOrder(ABC):
    """Step lengths that shrink by the `factors` after the given `shares` of the iterations.

    A grasp whose loss no longer falls goes to the next factor earlier.
    """

    needs_autograd: ClassVar[Literal[True]] = True

    iterations: int = 2000
    """Largest number of iterations per grasp."""
    step_translation: float = 1e-3
    """Step length s_t of the root translation in metres."""
    step_rotation: float = 1e-2
    """Step length s_r of the root rotation in radians (the paper takes 0.002)."""
    step_joints: float = 2e-2
    """Step length s_q of the joints in radians, 0.1 m per radian for prismatic joints (the paper takes 0.01)."""
    shares: tuple[float, ...] = (0.5, 0.8)
    """Shares of the iterations after which the steps shrink."""
    factors: tuple[float, ...] = (0.1, 0.01)
    """Factors of the step lengths from then on."""
    patience: int = 200
    """Iterations without progress after which a grasp continues with shorter steps, or ends after the last factor."""
    progress: float = 0.01
    """Smallest relative fall of the loss that counts as progress."""
    transport: bool = False
    """Equivalent gradient transport: the object's gradient acts through the links (no longer a gradient)."""

    def __post_init__(self) -> None:
        """Refuse a schedule that cannot run.

        Raises:
            GraspRefineError: a field of another type, or not one factor per share.
        """
        check_fields(self)
        if len(self.shares) != len(self.factors):
            name = type(self).__name__.lower().removesuffix("options")
            raise GraspRefineError(
                f"{name}: shares and factors must match, got {len(self.shares)} and {len(self.factors)} numbers"
            )

    @abstractmethod
    def initial_memory(self, count: int, dof: int) -> np.ndarray:
        """Return the averages (count, m) before the first step."""

    @abstractmethod
    def direction(self, gradient: torch.Tensor, memory: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return directions (batch, 6 + n) to step against, in units of the step lengths, and the next averages.

        Args:
            gradient: Gradient (batch, 6 + n): the root's as a body twist (v, w), then that of the joint values.
            memory: Averages (batch, m) after the last step.
        """

    def start(self, problem: Differentiable, point: Point) -> tuple[Point, Descending]:
        """Return the points in the number type of the problem, and the initial state."""
        # A joint at its limit is not beyond it because its value was rounded.
        q = problem.tensor(point.q).clamp(problem.lower, problem.upper)
        count = len(point.T)
        state = Descending(np.zeros(count, dtype=np.int64), self.initial_memory(count, 6 + point.q.shape[1]))
        return Point(_array(problem.tensor(point.T)), _array(q)), state

    def accept(self, slots: Slots, known: Any) -> tuple[np.ndarray, Descending]:
        """Return that all trials are accepted, and the state as it is."""
        return np.ones(len(slots.member), dtype=bool), slots.state

    def assess(self, problem: Differentiable, slots: Slots, record: Record) -> tuple[Slots, np.ndarray, np.ndarray]:
        """Return the slots with their phases, the status of each member, and that none should restart."""
        state = slots.state
        stuck, last = slots.since >= self.patience, state.phase == len(self.factors)
        phase = np.maximum(state.phase + (stuck & ~last), self.first_phase(record.iterations - 1))
        status = np.where(stuck & last, Status.STALLED, Status.RUNNING)
        status[~np.isfinite(slots.loss)] = Status.NOT_FINITE
        slots = replace(slots, since=np.where(stuck, 0, slots.since), state=replace(state, phase=phase))
        return slots, status, np.zeros(len(status), dtype=bool)

    def step(self, problem: Differentiable, slots: Slots) -> tuple[Point, Descending]:
        """Return the points after a step against the direction, and the next averages."""
        state, lower, upper = slots.state, problem.lower, problem.upper
        T, q, gradient, memory = map(problem.tensor, (slots.point.T, slots.point.q, slots.known.gradient, state.memory))
        direction, memory = self.direction(gradient, memory)
        scale = T.new_tensor((1.0, *self.factors))[state.phase.tolist()][:, None]
        length = T.new_tensor([self.step_translation] * 3 + [self.step_rotation] * 3)
        moved = q - direction[:, 6:] * self.step_joints * problem.per_radian * scale
        # A joint within its limits never leaves them.
        moved = moved.maximum(q.minimum(lower)).minimum(q.maximum(upper))
        T = retract(T, -direction[:, :6] * length * scale)
        return Point(_array(T), _array(moved)), replace(state, memory=_array(memory))

    def first_phase(self, iteration: np.ndarray) -> np.ndarray:
        """Return the earliest phase of the schedule at iterations (batch,), the first one being 0."""
        return (iteration[:, None] >= np.array(self.shares) * self.iterations).sum(axis=1)


def _array(tensor: torch.Tensor) -> np.ndarray:
    return tensor.double().cpu().numpy()
