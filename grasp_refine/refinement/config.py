"""All settings of a refinement in one value."""

from dataclasses import dataclass, field
from math import inf
from typing import Literal

from grasp_refine.core.arguments import check_fields, check_kind
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.forces.quality import CONFIDENCE
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.refinement.solvers.iterate import Solver, check_solver
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.terms.scales import Scales
from grasp_refine.refinement.terms.term import Setup, Term
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.derivative import Derivative


@dataclass(frozen=True)
class Config:
    """All settings of a refinement."""

    solver: Solver = field(default_factory=LevenbergMarquardt)
    """Solver that moves the hand: `LevenbergMarquardt`, `Descent`, `Adam`, or one of your own with the members of
    `Solver`."""
    derivative: Derivative = field(default_factory=ContactKinematics)
    """Derivative of witness points that descent and Adam use; Levenberg-Marquardt has its own contact kinematics."""
    contact_selection: ContactSelection = field(default_factory=ContactSelection)
    """Selection of the links that should touch the object where there are no targets."""
    nearest: bool = False
    """Whether, without targets, the links that should touch take their initial witness points as targets."""
    weights: Weights = field(default_factory=Weights)
    """Weights of our terms of the loss."""
    terms: tuple[Term, ...] = ()
    """More terms of the loss, which are your own."""
    scales: Scales = field(default_factory=Scales)
    """Movements of equal cost in the term that keeps a grasp near its start."""
    max_move: MaxMove = field(default_factory=MaxMove)
    """Bounds on the movement of a grasp from its start."""
    freeze: tuple[str, ...] = ()
    """Parts of the hand that keep their values to the last bit, by name: "palm", its "translation" or "rotation" alone,
    fingers (`Hand.fingers`) and joints. `Frozen.of` says what each keeps. Joint values beyond a limit go to it."""
    starts: int = 6
    """Number of starts from which Levenberg-Marquardt tries a grasp that may not hold."""
    prefer: Literal["closest", "balanced", "strongest"] = "closest"
    """Choice among grasps: the closest one to the input that is good enough, by `Displacement`; the closest one that
    also withstands strong pushes; or the strongest one, however far it is."""
    confidence: float = CONFIDENCE
    """Quality, the probability of holding, from which an input grasp is good enough with `prefer` "closest": only its
    contacts are closed. Grasps that have to move keep a reserve, see `force_closure_search.MOVED_SHARE`."""
    margin: float = 0.0
    """Contact margin in metres: the gap that contact links should keep from the object."""
    clearance: float | None = None
    """Gap in metres beside the margin that links without a target keep which move and are no contact links; None:
    `clearance.OTHER_MODEL_CLEARANCE_M` where another model of the hand is simulated, else 0."""
    pressure: float | None = None
    """Sum of the pressures of all contacts in newtons with which the squeeze presses; None: by the task, see
    `squeeze`."""
    tolerance: float = 1e-10
    """A grasp has converged when its loss (m^2) is below this; 1e-10 is a hundredth of a millimetre."""
    seconds: float = inf
    """Largest CPU time per grasp in seconds; its best iterate by then is the result."""
    width: int = 256
    """Largest number of grasps that Levenberg-Marquardt solves at once; finished ones are replaced by waiting ones."""
    seed: int = 0
    """Seed of all random numbers."""
    dtype: Literal["float64", "float32"] = "float64"
    """Number type of kinematics and losses; collision queries always run in double precision."""
    device: str = "cpu"
    """Torch device of kinematics and losses."""

    def __post_init__(self) -> None:
        """Refuse settings that cannot be used.

        Raises:
            GraspRefineError: a field of another type, a number out of its range, or a number type or device that
                Levenberg-Marquardt does not support.
        """
        check_solver(self.solver)
        check_fields(self)
        for term in self.terms:
            check_kind(f"{type(term).__name__}: weight", term.weight, float)
            if not 0.0 <= term.weight < inf:
                raise GraspRefineError(
                    f"{type(term).__name__}: weight must be at least 0 and finite, got {term.weight:g}"
                )
            if not (term.autograd if self.solver.needs_autograd else term.least_squares):
                wanted = "autograd" if self.solver.needs_autograd else "least_squares"
                raise GraspRefineError(
                    f"{type(term).__name__} cannot be minimised by {type(self.solver).__name__}: its {wanted} is False"
                )
        for name in ("width", "starts"):
            if getattr(self, name) < 1:
                raise GraspRefineError(f"{name} must be at least 1, got {getattr(self, name)}")
        optional = [name for name in ("clearance", "pressure") if getattr(self, name) is not None]
        for name in ("margin", *optional, "tolerance", "seed"):
            if not 0 <= getattr(self, name) < inf:
                raise GraspRefineError(f"{name} must be at least 0 and finite, got {getattr(self, name):g}")
        if not 0.0 < self.confidence < 1.0:
            raise GraspRefineError(f"confidence must be above 0 and below 1, got {self.confidence:g}")
        if not self.seconds > 0.0:
            raise GraspRefineError(f"seconds must be above 0, got {self.seconds:g}")
        if not self.solver.needs_autograd and (self.dtype, self.device) != ("float64", "cpu"):
            raise GraspRefineError(
                f"levenberg-marquardt runs in float64 on the cpu; {self.dtype} on {self.device} needs descent or adam"
            )

    def terms_of(self, setup: Setup) -> tuple[tuple[float, Term], ...]:
        """Return the terms of a refinement with their weights above 0, ours first."""
        own = ((term.weight, term.of(setup)) for term in self.terms if term.weight > 0.0 and term.applies(setup))
        return *self.weights.terms(setup, autograd=self.solver.needs_autograd), *own

    @property
    def holds(self) -> bool:
        """Whether grasps should hold the object, and not only touch it."""
        return not (self.solver.needs_autograd or self.nearest) and self.weights.wrench > 0.0
