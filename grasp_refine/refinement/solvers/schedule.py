"""Schedule of first-order solvers: step lengths that shrink."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from grasp_refine.core.arguments import check_fields
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import retract

if TYPE_CHECKING:
    # It takes seconds to load, and options are made of this class.
    import torch


@dataclass(frozen=True)
class Schedule:
    """Step lengths that shrink by the `factors` after the given `shares` of the iterations.

    A grasp whose loss no longer falls goes to the next factor earlier.
    """

    iterations: int = 2000
    """Largest number of iterations per grasp."""
    step_translation: float = 1e-3
    """Step length s_t of the root translation in metres."""
    step_rotation: float = 1e-2
    """Step length s_r of the root rotation in radians (the paper takes 0.002)."""
    step_joints: float = 2e-2
    """Step length s_q of the joints in radians, metres for prismatic joints (the paper takes 0.01)."""
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

    def first_stage(self, iteration: int) -> int:
        """Return the earliest stage of the schedule at an iteration."""
        return sum(iteration >= share * self.iterations for share in self.shares)

    def integrate(
        self,
        T: torch.Tensor,
        q: torch.Tensor,
        direction: torch.Tensor,
        stage: torch.Tensor,
        lower: torch.Tensor,
        upper: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return root poses and joint values after steps against `direction`, in units of the step lengths.

        Args:
            T: Root poses (batch, 4, 4).
            q: Joint values (batch, n).
            direction: (batch, 6 + n): of the root as a body twist (v, w), then of the joint values.
            stage: Stage of the schedule of each grasp (batch,).
            lower: Lower joint limits (n,); a joint within its limits never leaves them.
            upper: Upper joint limits (n,).
        """
        length = T.new_tensor([self.step_translation] * 3 + [self.step_rotation] * 3)
        scale = T.new_tensor((1.0, *self.factors))[stage][:, None]
        moved_q = q - direction[:, 6:] * self.step_joints * scale
        moved_q = moved_q.maximum(q.minimum(lower)).minimum(q.maximum(upper))
        return retract(T, -direction[:, :6] * length * scale), moved_q
