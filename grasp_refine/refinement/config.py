"""All settings of a refinement in one value."""

from dataclasses import dataclass, field
from math import inf
from typing import Literal

from grasp_refine.core.arguments import check_fields
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.refinement.losses import Scales, Weights
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.derivative import Derivative


@dataclass(frozen=True)
class Config:
    """All settings of a refinement."""

    solver: LevenbergMarquardt | Descent | Adam = field(default_factory=LevenbergMarquardt)
    """How the hand moves."""
    derivative: Derivative = field(default_factory=ContactKinematics)
    """How witness points are differentiated by descent; Levenberg-Marquardt has contact kinematics of its own."""
    contact_selection: ContactSelection = field(default_factory=ContactSelection)
    """Which links should touch the object where there are no targets."""
    nearest: bool = False
    """Without targets, the links that should touch have their first witness points as targets."""
    weights: Weights = field(default_factory=Weights)
    """How much each term of the loss counts."""
    scales: Scales = field(default_factory=Scales)
    """Which movements count the same where a grasp should stay near."""
    max_move: MaxMove = field(default_factory=MaxMove)
    """How far a grasp may be moved."""
    starts: int = 6
    """Without targets, Levenberg-Marquardt tries a grasp that may not hold from so many starts."""
    margin: float = 0.0
    """Contact margin in metres: the gap that contact links should keep."""
    tolerance: float = 1e-10
    """A grasp has converged when its loss (m^2) is below this; 1e-10 is a hundredth of a millimetre."""
    seconds: float = inf
    """Most CPU time for a grasp; what it has come to by then counts."""
    width: int = 256
    """Most grasps that Levenberg-Marquardt works on at once; those that are done make room for others."""
    seed: int = 0
    """Seed of everything that is drawn."""
    dtype: Literal["float64", "float32"] = "float64"
    """Number type of kinematics and losses; collision queries always run in double precision."""
    device: str = "cpu"
    """Torch device of kinematics and losses."""

    def __post_init__(self) -> None:
        """Refuse what nothing could be done with.

        Raises:
            GraspRefineError: a field of another kind, a number out of its range, or a number type or device that
                Levenberg-Marquardt does not have.
        """
        check_fields(self)
        for name in ("width", "starts"):
            if getattr(self, name) < 1:
                raise GraspRefineError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name in ("margin", "tolerance", "seed"):
            if not 0 <= getattr(self, name) < inf:
                raise GraspRefineError(f"{name} must be at least 0 and finite, got {getattr(self, name):g}")
        if not self.seconds > 0.0:
            raise GraspRefineError(f"seconds must be above 0, got {self.seconds:g}")
        if isinstance(self.solver, LevenbergMarquardt) and (self.dtype, self.device) != ("float64", "cpu"):
            raise GraspRefineError(
                f"levenberg-marquardt runs in float64 on the cpu; {self.dtype} on {self.device} needs descent or adam"
            )

    @property
    def holds(self) -> bool:
        """Whether grasps without targets should hold, and not just touch."""
        return isinstance(self.solver, LevenbergMarquardt) and self.weights.wrench > 0.0
