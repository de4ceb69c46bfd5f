"""What is compared: derivative methods with their settings, by the names that tables and options give them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from grasp_refine.witness.analytical import Analytical
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.direction import Direction
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.finite_difference import FiniteDifference
from grasp_refine.witness.neighborhood import Adaptive, Fixed
from grasp_refine.witness.patch import Patch
from grasp_refine.witness.rigid import Rigid
from grasp_refine.witness.rings import Neighbor
from grasp_refine.witness.slip import Coupling
from grasp_refine.witness.zeroth_order import ZerothOrder
from grasp_refine_apps.bench.align.descent import AlignDescent
from grasp_refine_apps.bench.align.levenberg_marquardt import AlignLevenbergMarquardt

MethodName = Literal[
    "distance", "direction", "analytical", "zeroth-order", "finite-difference", "contact-kinematics", "rigid"
]
NeighborhoodName = Literal["adaptive", "fixed", "neighbor"]
SolverName = Literal["descent", "levenberg-marquardt"]
WitnessName = Literal["plain", "patch"]

NEIGHBORHOODS: Mapping[NeighborhoodName, Adaptive | Fixed | Neighbor] = MappingProxyType(
    {"adaptive": Adaptive(), "fixed": Fixed(), "neighbor": Neighbor()}
)

FEW_TARGETS = 8
"""Methods that ask many queries per iteration run this fraction of the targets, as in the paper."""


@dataclass(frozen=True)
class Variant:
    """A derivative method with all that a solver does with it; one row of a table for each kind of body.

    Levenberg-Marquardt moves body 2 by contact kinematics over neighbourhoods of its own: nothing of it can be chosen
    but the margin, the budget in iterations and the witness.
    """

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
    solver: SolverName = "descent"
    """How the bodies move."""
    witness: WitnessName = "plain"
    """Which witness points the solver sees."""
    epsilon: float | None = None
    """Epsilon in metres of the patch witness that is used, or judges beside the plain one; None: there is none."""

    @staticmethod
    def least_squares(**settings: Any) -> Variant:
        """Levenberg-Marquardt; `settings` are margin, budget, witness and epsilon."""
        return Variant("contact-kinematics", transport=False, solver="levenberg-marquardt", **settings)

    @property
    def name(self) -> str:
        """What it is called first: the method of descent, or the other solver."""
        return self.method if self.solver == "descent" else self.solver

    @property
    def patch(self) -> Patch | None:
        """The patch witness that is used, or judges beside the plain one."""
        return None if self.epsilon is None else Patch(self.epsilon)

    @property
    def samples(self) -> bool:
        """Whether the method uses a neighbourhood that can be chosen."""
        return self.solver == "descent" and self.method in ("distance", "direction", "contact-kinematics")

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

    def built(self, seed: int) -> AlignDescent | AlignLevenbergMarquardt:
        """The solver that runs it."""
        patch = self.patch if self.witness == "patch" else None
        if self.solver == "levenberg-marquardt":
            assert self.budget is not None, "only descent runs for a time"
            return AlignLevenbergMarquardt(self.margin, self.budget, patch, seed)
        return AlignDescent(
            method=self.derivative(seed),
            transport=self.transport,
            optimise=self.optimise,
            margin=self.margin,
            step_size=self.step_size,
            iterations=self.budget,
            # A budget is for all targets of a pair.
            seconds=None if self.budget_s is None else self.budget_s / self.every,
            patch=patch,
        )

    def queries(self, iterations: np.ndarray) -> np.ndarray:
        """Witness queries of tasks: one an iteration, and those of the method itself."""
        inner = {"zeroth-order": 2 * ZerothOrder().samples, "finite-difference": 12}
        return iterations * (1 + inner.get(self.method, 0))

    def columns(self) -> dict[str, Any]:
        """What it is, as entries of a row."""
        return {
            "method": self.method,
            "neighborhood": self.neighborhood if self.samples else None,
            "solver": self.solver,
            "transport": self.transport,
            "margin": self.margin,
            "budget": self.budget,
            "budget_s": self.budget_s,
            "witness": self.witness,
            "epsilon": self.epsilon,
            "coupling": self.coupling if self.slips else None,
            "step_size": self.step_size if self.solver == "descent" else None,
            "optimise": self.optimise,
        }
