"""Options of the refinement, common to all commands that refine."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, is_dataclass, replace
from functools import cache
from math import inf
from operator import attrgetter
from typing import Annotated, Any, ClassVar, Literal, get_args, get_type_hints

from tyro.conf import DisallowNone, arg
from tyro.constructors import PrimitiveConstructorSpec

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.refinement.config import Config
from grasp_refine.refinement.max_move import MaxMove
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.terms.scales import Scales
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.scene.contact_selection import ContactSelection
from grasp_refine.witness.analytical import Analytical
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.direction import Direction
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.finite_difference import FiniteDifference
from grasp_refine.witness.neighborhood import Adaptive, Fixed
from grasp_refine.witness.rigid import Rigid
from grasp_refine.witness.rings import Neighbor
from grasp_refine.witness.zeroth_order import ZerothOrder
from grasp_refine_apps.commands.option_rules import OptionGroup
from grasp_refine_apps.commands.options import check_device, check_numbers
from grasp_refine_apps.report.command_line import flag
from grasp_refine_apps.report.fields import Without

FIRST_ORDER_TOLERANCE = 1e-7
"""Default of --tolerance with descent and adam, which converge slowly to smaller losses, m^2."""


def _three(words: list[str]) -> tuple[float, ...]:
    """Parse three numbers, separated by commas or spaces.

    Raises:
        ValueError: there are more or fewer, or a word is no number.
    """
    numbers = [word for word in ",".join(words).split(",") if word]
    if len(numbers) != 3:
        raise ValueError(f"needs 3 numbers, as in 0.01,0.1,0.2, got {len(numbers)}")
    return tuple(float(number) for number in numbers)


THREE = PrimitiveConstructorSpec(
    nargs="*",
    metavar="M,RAD,RAD",
    instance_from_str=_three,
    is_instance=lambda value: value is None or isinstance(value, tuple),
    str_from_instance=lambda value: [",".join(f"{number:g}" for number in value or ())],
)
"""Constructor of an option that takes three numbers."""

OF_SOLVER, OF_DERIVATIVE = Without("iterations", "transport"), Without("neighborhood", "seed")
"""Fields of methods that all of their kind share: they have an option of their own, without a prefix."""


@dataclass(frozen=True)
class Settings:
    """Options of the refinement. A method chosen by name has its options in the field of that name."""

    groups: ClassVar[tuple[OptionGroup, ...]] = (
        OptionGroup(
            "refinement",
            "Aim and effort of the refinement.",
            (
                *("prefer", "confidence", "geometry_only", "starts", "max_move", "freeze"),
                *("contacts", "reach", "other_link_distance"),
                *("margin", "clearance", "pressure", "seconds", "iterations", "tolerance", "seed", "solver"),
            ),
        ),
        OptionGroup(
            "method",
            "Numbers of the solver, and the derivatives and devices of descent and adam.",
            ("derivative", "neighborhood", "transport", "width", "dtype", "device", "weights", "scales"),
            on_demand="--solver",
        ),
    )

    solver: Literal["levenberg-marquardt", "descent", "adam"] = "levenberg-marquardt"
    """Solver: damped Gauss-Newton steps, normalised gradient descent (the paper's), or Adam. `refine-grasp run --solver
    NAME --help` shows its own options, derivatives and the weights of the loss."""
    derivative: Literal[
        "contact-kinematics", "distance", "direction", "analytical", "zeroth-order", "finite-difference", "rigid"
    ] = "contact-kinematics"
    """Derivative of witness points in descent and adam: from fitted curvatures, by the paper's distance smoothing, or
    by one of the methods for comparison (`bench align` measures them all)."""
    neighborhood: Literal["adaptive", "fixed", "neighbor"] = "adaptive"
    """Surface samples around a witness point: within the distance of the target, within a fixed fraction of the body,
    or the mesh vertices around it."""
    iterations: Annotated[
        DisallowNone[int | None],
        arg(help_behavior_hint=f"(default: {LevenbergMarquardt.iterations}; descent, adam: {Descent.iterations})"),
    ] = None
    """Maximum iterations per grasp or, in the search for force closure, per phase of a start, which has 15 to 40."""
    starts: int = Config.starts
    """Maximum number of starts for a grasp that may still slip, each nearby, until one should hold. More starts find
    more grasps that hold, farther from the input grasps."""
    prefer: Literal["closest", "balanced", "strongest"] = Config.prefer
    """Choice among grasps that hold: the closest one to the input grasp; the closest one that also withstands strong
    pushes; or the strongest one, however far it is."""
    confidence: float = Config.confidence
    """Quality (probability of holding) from which --prefer closest leaves an input grasp as it is and only closes its
    contacts. Higher: more grasps are moved, and more of them hold."""
    max_move: Annotated[
        DisallowNone[tuple[float, ...] | None], THREE, arg(help_behavior_hint="(default: no limit)")
    ] = None
    """Largest change of a grasp, as in 0.01,0.1,0.2: translation of the hand in metres, its rotation in radians, and
    each joint in radians (a prismatic one: 0.1 m per radian); inf: no limit."""
    freeze: Annotated[tuple[str, ...], arg(metavar="NAME [...]", help_behavior_hint="(default: nothing)")] = ()
    """Parts of the hand that do not move at all: palm, or its translation or rotation alone; fingers, as
    `refine-grasp hands` lists them; joints. Pregrasp and squeeze move them nevertheless."""
    seconds: Annotated[DisallowNone[float | None], arg(help_behavior_hint="(default: no limit)")] = None
    """CPU time after which levenberg-marquardt ends the work on a grasp; the best result until then counts."""
    geometry_only: bool = False
    """Solve only for contact without penetration, close to the input grasp; whether the grasp should hold is only
    reported. Much faster, and grasps move less."""
    tolerance: Annotated[
        DisallowNone[float | None],
        arg(help_behavior_hint=f"(default: {Config.tolerance:g}; descent, adam: {FIRST_ORDER_TOLERANCE:g})"),
    ] = None
    """Loss (m^2) below which a grasp is converged; 1e-10 is a hundredth of a millimetre, 1e-7 a third of one."""
    margin: float = Config.margin
    """Gap that contact links should keep, metres."""
    clearance: Annotated[
        DisallowNone[float | None], arg(help_behavior_hint="(default: 0; 0.0015 where an MJCF is simulated)")
    ] = Config.clearance
    """Gap beside it that all other links which move should keep, metres: another model of the hand may be thicker
    there, and would eject objects that they touch."""
    pressure: Annotated[
        DisallowNone[float | None], arg(help_behavior_hint="(default: 30, or more where the task demands it)")
    ] = Config.pressure
    """Newtons with which all contacts together press when the hand squeezes, as far as its actuators can. More carries
    heavier objects, and loses more objects in soft contacts."""
    reach: float = ContactSelection.reach
    """Contact links (fingertips) within this distance (metres) of the object should touch it."""
    other_link_distance: float = ContactSelection.other_link_distance
    """All other links within this distance (metres) of the object should touch it."""
    contacts: Annotated[
        tuple[str, ...], arg(metavar="LINK|FINGER [...]", help_behavior_hint="(default: links within reach)")
    ] = ()
    """Links, or fingers as `refine-grasp hands` lists them, that should touch, instead of links within reach."""
    transport: bool = Descent.transport
    """With descent or adam, equivalent gradient transport: the object's gradient acts through the links."""
    width: int = Config.width
    """Maximum batch size of levenberg-marquardt."""
    seed: int = Config.seed
    """Random seed."""
    dtype: Literal["float64", "float32"] = Config.dtype
    """Number type of kinematics and losses; collision queries always run in double precision."""
    device: str = Config.device
    """Torch device of kinematics and losses, such as cuda; collision queries always run on the CPU."""
    levenberg_marquardt: Annotated[LevenbergMarquardt, OF_SOLVER] = field(default_factory=LevenbergMarquardt)
    """With --solver levenberg-marquardt."""
    descent: Annotated[Descent, OF_SOLVER] = field(default_factory=Descent)
    """With --solver descent."""
    adam: Annotated[Adam, OF_SOLVER] = field(default_factory=Adam)
    """With --solver adam."""
    contact_kinematics: Annotated[ContactKinematics, OF_DERIVATIVE] = field(default_factory=ContactKinematics)
    """With --derivative contact-kinematics."""
    distance: Annotated[Distance, OF_DERIVATIVE] = field(default_factory=Distance)
    """With --derivative distance."""
    direction: Annotated[Direction, OF_DERIVATIVE] = field(default_factory=Direction)
    """With --derivative direction."""
    analytical: Analytical = field(default_factory=Analytical)
    """With --derivative analytical."""
    zeroth_order: Annotated[ZerothOrder, OF_DERIVATIVE] = field(default_factory=ZerothOrder)
    """With --derivative zeroth-order."""
    finite_difference: FiniteDifference = field(default_factory=FiniteDifference)
    """With --derivative finite-difference."""
    rigid: Rigid = field(default_factory=Rigid)
    """With --derivative rigid; it has no options."""
    adaptive: Adaptive = field(default_factory=Adaptive)
    """With --neighborhood adaptive."""
    fixed: Fixed = field(default_factory=Fixed)
    """With --neighborhood fixed."""
    neighbor: Neighbor = field(default_factory=Neighbor)
    """With --neighborhood neighbor."""
    weights: Annotated[Weights, Without("direction")] = field(default_factory=Weights)
    """Weights of the terms of the loss, a sum of squares."""
    scales: Scales = field(default_factory=Scales)
    """Movements that count the same, with --weights.stay-near."""

    def config(self, *, nearest: bool = False) -> Config:
        """Return the settings of the refinement.

        Args:
            nearest: Links should touch at their initial closest points.

        Raises:
            GraspRefineError: a number out of its range, options of a method that was not chosen, or a device that
                is not available.
        """
        check_numbers(self)
        check_device(self.device, self.dtype)
        for name, reason in self.unused():
            self._check_default(name, reason)
        if self.seconds == 0:
            raise GraspRefineError("--seconds must be above 0, got 0")
        if nearest and self.solver == "levenberg-marquardt":
            self._check_nearest()
        solver, derivative, neighborhood = (
            getattr(self, _field(name)) for name in (self.solver, self.derivative, self.neighborhood)
        )
        iterations = solver.iterations if self.iterations is None else self.iterations
        tolerance = self.tolerance
        if tolerance is None:
            tolerance = Config.tolerance if self.solver == "levenberg-marquardt" else FIRST_ORDER_TOLERANCE
        return Config(
            solver=_method(solver, iterations=iterations, transport=self.transport),
            derivative=_method(derivative, neighborhood=neighborhood, seed=self.seed),
            contact_selection=ContactSelection(
                self.reach, self.other_link_distance, max(self.reach, ContactSelection.farthest), self.contacts
            ),
            nearest=nearest,
            weights=replace(self.weights, wrench=0.0) if self.geometry_only else self.weights,
            scales=self.scales,
            max_move=MaxMove() if self.max_move is None else MaxMove(*self.max_move),
            freeze=self.freeze,
            starts=self.starts,
            prefer=self.prefer,
            confidence=self.confidence,
            margin=self.margin,
            clearance=self.clearance,
            pressure=self.pressure,
            tolerance=tolerance,
            seconds=inf if self.seconds is None else self.seconds,
            width=self.width,
            seed=self.seed,
            dtype=self.dtype,
            device=self.device,
        )

    def _check_nearest(self) -> None:
        """Refuse options that have no effect on links that touch where they are nearest.

        Raises:
            GraspRefineError: names the option.
        """
        for name in FORCE_CLOSURE_FIELDS:
            self._check_default(name, "no effect with `--targets nearest`: links touch at their nearest points")

    def unused(self) -> Iterator[tuple[str, str]]:
        """Yield the names of the fields without effect given the others, such as "weights.wrench", each with why."""
        if not hasattr(getattr(self, _field(self.derivative)), "neighborhood"):
            yield "neighborhood", f"not used by --derivative {self.derivative}"
        for choice in ("solver", "derivative", "neighborhood"):
            chosen = getattr(self, choice)
            for name in _methods(choice):
                if name != chosen:
                    yield _field(name), f"only with --{choice} {name}; it is {chosen}"
        if self.solver == "levenberg-marquardt":
            methods = map(_field, (*_methods("derivative"), *_methods("neighborhood")))
            fixed = "levenberg-marquardt always uses contact kinematics, in double precision on the CPU"
            for name in ("derivative", "neighborhood", "transport", "dtype", "device", *methods):
                yield name, f"only with --solver descent or adam: {fixed}"
            yield "weights.joint_limits", "only with --solver descent or adam: here limits hold exactly"
        else:
            for name in ("width", "max_move", "seconds", *FORCE_CLOSURE_FIELDS):
                yield name, f"only with --solver levenberg-marquardt; it is {self.solver}"
            if self.derivative == "contact-kinematics" and not self.contact_kinematics.sampled:
                for name in ("adaptive.samples", "adaptive.minimum", "fixed.samples", "fixed.minimum"):
                    yield name, "only with --contact-kinematics.sampled: without it, all samples around count"
        if self.geometry_only:
            for name in ("starts", "prefer", "confidence", "weights.wrench"):
                yield name, "no effect with --geometry-only: leave one of them out"
        if self.prefer != "closest":
            yield "confidence", f"only with --prefer closest; it is {self.prefer}"
        if self.weights.wrench == 0:
            for name in ("starts", "prefer", "confidence"):
                yield name, "only for grasps that should hold: with --weights.wrench 0 it has no effect"
        if self.weights.stay_near == 0:
            yield "scales", "only with --weights.stay-near, which is 0"

    def _check_default(self, name: str, reason: str) -> None:
        """Refuse another value than the default of a field."""
        value = attrgetter(name)(self)
        if value != attrgetter(name)(Settings()):
            option = f"{flag(name)}.*" if is_dataclass(value) else flag(name)
            raise GraspRefineError(f"{f'{option} {value}' if isinstance(value, str) else option}: {reason}")


FORCE_CLOSURE_FIELDS = ("geometry_only", "starts", "prefer", "confidence", "weights.wrench")
"""Fields of the search for force closure."""


@cache
def _methods(choice: str) -> tuple[str, ...]:
    """Return the names of the methods that a field can have."""
    return get_args(get_type_hints(Settings)[choice])


def _field(method: str) -> str:
    """Return the name of the field with the options of a method."""
    return method.replace("-", "_")


def _method(method: Any, **shared: object) -> Any:
    """Return a method with the values of `shared` that it has fields for."""
    return replace(method, **{name: value for name, value in shared.items() if hasattr(method, name)})
