"""The options that say how grasps are refined; every command that refines has them."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Literal, TypeVar, get_args, get_type_hints

from tyro.conf import Suppress

from grasp_refine.commands.options import check_device, check_numbers
from grasp_refine.config import Config
from grasp_refine.errors import GraspRefineError
from grasp_refine.losses import Weights
from grasp_refine.solvers.descent import Descent
from grasp_refine.witness.analytical import Analytical
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.direction import Direction
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.finite_difference import FiniteDifference
from grasp_refine.witness.neighborhood import Adaptive, Fixed
from grasp_refine.witness.rigid import Rigid
from grasp_refine.witness.rings import Neighbor
from grasp_refine.witness.zeroth_order import ZerothOrder

Method = TypeVar("Method")


# What has an option of its own, without a prefix, is left out of the options of a method.
@dataclass(frozen=True)
class DescentOptions(Descent):
    """The options of normalised gradient descent."""

    iterations: Suppress[int] = Descent.iterations
    transport: Suppress[bool] = Descent.transport


@dataclass(frozen=True)
class ContactKinematicsOptions(ContactKinematics):
    """The options of contact kinematics."""

    neighborhood: Suppress[Adaptive | Fixed | Neighbor] = field(default_factory=Adaptive)
    seed: Suppress[int] = ContactKinematics.seed


@dataclass(frozen=True)
class DistanceOptions(Distance):
    """The options of distance smoothing."""

    neighborhood: Suppress[Adaptive | Fixed | Neighbor] = field(default_factory=Adaptive)
    seed: Suppress[int] = Distance.seed


@dataclass(frozen=True)
class DirectionOptions(Direction):
    """The options of direction smoothing."""

    neighborhood: Suppress[Adaptive | Fixed | Neighbor] = field(default_factory=Adaptive)
    seed: Suppress[int] = Direction.seed


@dataclass(frozen=True)
class ZerothOrderOptions(ZerothOrder):
    """The options of zeroth-order smoothing."""

    seed: Suppress[int] = ZerothOrder.seed


@dataclass(frozen=True)
class AnalyticalOptions(Analytical):
    """The options of analytical derivatives."""


@dataclass(frozen=True)
class FiniteDifferenceOptions(FiniteDifference):
    """The options of finite differences."""


@dataclass(frozen=True)
class RigidOptions(Rigid):
    """Rigid points have no options."""


@dataclass(frozen=True)
class Settings:
    """How grasps are refined. A method that is chosen by name has its options in the field of that name."""

    solver: Literal["descent"] = "descent"
    """How the hand moves: normalised gradient descent."""
    derivative: Literal[
        "contact-kinematics", "distance", "direction", "analytical", "zeroth-order", "finite-difference", "rigid"
    ] = "contact-kinematics"
    """How witness points are differentiated: by fitted curvatures, by the paper's distance smoothing, or by what it is
    compared with (`bench align` measures them all)."""
    neighborhood: Literal["adaptive", "fixed", "neighbor"] = "adaptive"
    """Which samples stand for the surface near a witness: as far as the target is, within a fixed fraction of the body,
    or the mesh vertices around it."""
    iterations: int = Descent.iterations
    """Most iterations per grasp."""
    tolerance: float = Config.tolerance
    """Converged when the loss (m^2) is below this; 1e-7 is a third of a millimetre."""
    margin: float = Config.margin
    """Gap in metres that contact links should keep."""
    reach: float = Config.reach
    """Automatic targets: contact links within this distance (metres) of the object are meant to touch it."""
    transport: bool = Descent.transport
    """Equivalent gradient transport: the object's gradient acts through the links."""
    seed: int = Config.seed
    """Seed of everything that is drawn."""
    dtype: Literal["float64", "float32"] = Config.dtype
    """Number type of kinematics and losses; collision queries always run in double precision."""
    device: str = Config.device
    """Torch device of kinematics and losses, such as cuda; collision queries always run on the CPU."""
    descent: DescentOptions = field(default_factory=DescentOptions)
    """With --solver descent."""
    contact_kinematics: ContactKinematicsOptions = field(default_factory=ContactKinematicsOptions)
    """With --derivative contact-kinematics."""
    distance: DistanceOptions = field(default_factory=DistanceOptions)
    """With --derivative distance."""
    direction: DirectionOptions = field(default_factory=DirectionOptions)
    """With --derivative direction."""
    analytical: AnalyticalOptions = field(default_factory=AnalyticalOptions)
    """With --derivative analytical."""
    zeroth_order: ZerothOrderOptions = field(default_factory=ZerothOrderOptions)
    """With --derivative zeroth-order."""
    finite_difference: FiniteDifferenceOptions = field(default_factory=FiniteDifferenceOptions)
    """With --derivative finite-difference."""
    rigid: Suppress[RigidOptions] = field(default_factory=RigidOptions)
    adaptive: Adaptive = field(default_factory=Adaptive)
    """With --neighborhood adaptive."""
    fixed: Fixed = field(default_factory=Fixed)
    """With --neighborhood fixed."""
    neighbor: Neighbor = field(default_factory=Neighbor)
    """With --neighborhood neighbor."""
    weights: Weights = field(default_factory=Weights)
    """How much each term of the loss, a sum of squares, counts."""

    def config(self) -> Config:
        """The settings of the refinement.

        Raises:
            GraspRefineError: a number out of its range, options of a method that was not chosen, or a device that
                is not here.
        """
        check_numbers(self)
        for choice in ("solver", "derivative", "neighborhood"):
            self._check_unused(choice)
        check_device(self.device, self.dtype)
        if self.neighborhood != Settings.neighborhood and not self._has_samples():
            raise GraspRefineError(f"--derivative {self.derivative} has no use for --neighborhood {self.neighborhood}")
        solver, derivative, neighborhood = (
            getattr(self, name.replace("-", "_")) for name in (self.solver, self.derivative, self.neighborhood)
        )
        return Config(
            solver=_method(solver, iterations=self.iterations, transport=self.transport),
            derivative=_method(derivative, neighborhood=neighborhood, seed=self.seed),
            weights=self.weights,
            margin=self.margin,
            reach=self.reach,
            tolerance=self.tolerance,
            seed=self.seed,
            dtype=self.dtype,
            device=self.device,
        )

    def _has_samples(self) -> bool:
        """Whether the derivative method looks at surface samples."""
        return hasattr(getattr(self, self.derivative.replace("-", "_")), "neighborhood")

    def _check_unused(self, choice: str) -> None:
        """Refuse options of the methods that were not chosen, which would be ignored."""
        chosen = getattr(self, choice)
        for name in get_args(get_type_hints(Settings)[choice]):
            options = getattr(self, name.replace("-", "_"))
            if name != chosen and options != type(options)():
                raise GraspRefineError(f"options --{name}.* need --{choice} {name}; it is {chosen}")


def _method(options: Method, **others: object) -> Method:
    """The method that `options` describe, with the values of what has options of its own, where it has such a field."""
    given = {field.name: getattr(options, field.name) for field in fields(options)}
    return type(options).__base__(**given | {name: value for name, value in others.items() if name in given})
