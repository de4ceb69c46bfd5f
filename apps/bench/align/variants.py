"""What is compared: derivative methods with their settings, by the names that tables and options give them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

from grasp_refine.witness.analytical import Analytical
from grasp_refine.witness.autograd import Derivative
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.direction import Direction
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.finite_difference import FiniteDifference
from grasp_refine.witness.neighborhood import Adaptive, Fixed
from grasp_refine.witness.rigid import Rigid
from grasp_refine.witness.rings import Neighbor
from grasp_refine.witness.slip import Coupling
from grasp_refine.witness.zeroth_order import ZerothOrder

from .descent import AlignDescent

MethodName = Literal[
    "distance", "direction", "analytical", "zeroth-order", "finite-difference", "contact-kinematics", "rigid"
]
NeighborhoodName = Literal["adaptive", "fixed", "neighbor"]

NEIGHBORHOODS: Mapping[NeighborhoodName, Adaptive | Fixed | Neighbor] = MappingProxyType(
    {"adaptive": Adaptive(), "fixed": Fixed(), "neighbor": Neighbor()}
)

FEW_TARGETS = 8
"""Methods that ask many queries per iteration run this fraction of the targets, as in the paper."""


@dataclass(frozen=True)
class Variant:
    """A derivative method with all that descent does with it; one row of a table for each kind of body."""

    method: MethodName = "distance"
    """How witness points are differentiated."""
    neighborhood: NeighborhoodName = "adaptive"
    """Which samples smoothing uses; methods without samples ignore it."""
    coupling: Coupling = "one-sided"
    """How both slips act together; `one-sided` are the paper's equations."""
    transport: bool = True
    """Equivalent gradient transport."""
    optimise: Literal["T2", "T1T2"] = "T2"
    """Which bodies move."""
    margin: float = 1e-3
    """Contact margin in metres."""
    step_size: float = 10.0
    """s_r at first."""
    budget: int | None = 2000
    """Iterations; None: `budget_s`."""
    budget_s: float | None = None
    """CPU seconds per pair, all its tasks together."""

    @property
    def samples(self) -> bool:
        """Whether the method uses a neighbourhood."""
        return self.method in ("distance", "direction", "contact-kinematics")

    @property
    def slips(self) -> bool:
        """Whether the method has slip matrices to couple."""
        return self.method in ("distance", "direction", "analytical")

    @property
    def every(self) -> int:
        """One of so many targets is run."""
        return FEW_TARGETS if self.method in ("zeroth-order", "finite-difference") else 1

    def derivative(self, seed: int) -> Derivative:
        """The derivative method."""
        near = NEIGHBORHOODS[self.neighborhood]
        match self.method:
            case "distance":
                # Differentiating the smoothed point, as the paper does, moves that point in the self term.
                own = self.coupling == "one-sided"
                return Distance(neighborhood=near, coupling=self.coupling, smoothed_self=own, seed=seed)
            case "direction":
                return Direction(neighborhood=near, coupling=self.coupling, seed=seed)
            case "analytical":
                return Analytical(coupling=self.coupling)
            case "contact-kinematics":
                return ContactKinematics(neighborhood=near, seed=seed)
            case "zeroth-order":
                return ZerothOrder(seed=seed)
            case "finite-difference":
                return FiniteDifference()
            case "rigid":
                return Rigid()

    def solver(self, seed: int) -> AlignDescent:
        """The descent that runs it."""
        return AlignDescent(
            method=self.derivative(seed),
            transport=self.transport,
            optimise=self.optimise,
            margin=self.margin,
            step_size=self.step_size,
            iterations=self.budget,
            # A budget is for all targets of a pair.
            seconds=None if self.budget_s is None else self.budget_s / self.every,
        )

    def queries(self, iterations: int) -> int:
        """Witness queries of a task: one an iteration, and those of the method itself."""
        inner = {"zeroth-order": 2 * ZerothOrder().samples, "finite-difference": 12}
        return iterations * (1 + inner.get(self.method, 0))

    def columns(self) -> dict[str, Any]:
        """What it is, as entries of a row."""
        return {
            "method": self.method,
            "neighborhood": self.neighborhood if self.samples else None,
            "solver": "descent",
            "transport": self.transport,
            "margin": self.margin,
            "budget": self.budget,
            "budget_s": self.budget_s,
            "witness": "plain",
            "coupling": self.coupling if self.slips else None,
            "step_size": self.step_size,
            "optimise": self.optimise,
        }
