"""Variants to compare: derivative methods with their settings, under the names of tables and options."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.direction import Direction
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.neighborhood import Adaptive
from grasp_refine.witness.slip import Coupling
from grasp_refine.witness.zeroth_order import ZerothOrder
from grasp_refine_apps.bench.align.patch import Patch
from grasp_refine_apps.bench.derivatives import NeighborhoodName, make_derivative

MethodName = Literal[
    "distance", "direction", "analytical", "zeroth-order", "finite-difference", "contact-kinematics", "rigid"
]
SolverName = Literal["descent", "closed-form", "levenberg-marquardt", "closed-form-first"]
WitnessName = Literal["plain", "patch"]

TARGET_STRIDE = 8
"""Stride of the targets for methods with many queries per iteration, as in the paper."""


ADAPTIVE = Adaptive(samples=32, smallest=16.0)
"""Adaptive neighbourhoods of descent, which end as wide as the body.

A narrower neighbourhood is a nearly flat patch. Witness points seem to slide freely along it, and the required rotation
of the body does not show: with one candidate spacing, 11 % fewer tasks on convex hulls end below 1e-8 m^2.
"""


@dataclass(frozen=True)
class Variant:
    """A derivative method with all settings of its solver; one row of a table for each kind of body.

    Levenberg-Marquardt moves body 2 by contact kinematics over neighbourhoods of its own; its only settings are the
    margin, the budget in iterations and the witness. The closed form has a margin alone: it takes no derivative.
    """

    method: MethodName = "distance"
    """Derivative method of the witness points."""
    neighborhood: NeighborhoodName = "adaptive"
    """Neighbourhood of the samples for smoothing; methods without samples ignore it."""
    coupling: Coupling = "one-sided"
    """Coupling of the slips of both bodies; `one-sided` are the paper's equations."""
    transport: bool = True
    """Equivalent gradient transport."""
    optimise: Literal["T2", "T1T2"] = "T2"
    """Bodies that move."""
    margin: float = 1e-3
    """Contact margin in metres."""
    step_size: float = 10.0
    """Initial s_r."""
    budget: int | None = 2000
    """Budget in iterations; None: `budget_s`."""
    budget_s: float | None = None
    """Budget in CPU seconds per pair, for all its tasks together."""
    solver: SolverName = "descent"
    """Solver that moves the bodies."""
    witness: WitnessName = "plain"
    """Witness points that the solver uses."""
    epsilon: float | None = None
    """Epsilon in metres of the patch witness that is used, or measured beside the plain one; None: no patch witness."""

    @staticmethod
    def least_squares(*, with_closed_form: bool = False, **settings: Any) -> Variant:
        """Make a variant of Levenberg-Marquardt; `settings` are margin, budget, witness and epsilon.

        With the closed form, it is the first pose at which a stalled task starts again, and every third after it.
        """
        solver: SolverName = "closed-form-first" if with_closed_form else "levenberg-marquardt"
        return Variant("contact-kinematics", transport=False, solver=solver, **settings)

    @staticmethod
    def closed_form(**settings: Any) -> Variant:
        """Make the variant of opposite normals at the targets, alone; `settings` are margin and epsilon."""
        return Variant(transport=False, solver="closed-form", budget=1, **settings)

    @property
    def name(self) -> str:
        """First word of the label: the method of descent, or the other solver."""
        return self.method if self.solver == "descent" else self.solver

    @property
    def patch(self) -> Patch | None:
        """Patch witness that is used, or measured beside the plain one."""
        return None if self.epsilon is None else Patch(self.epsilon)

    @property
    def solver_patch(self) -> Patch | None:
        """Patch witness that the solver uses; None: plain witness points."""
        return self.patch if self.witness == "patch" else None

    @property
    def with_closed_form(self) -> bool:
        """Whether the solver tries opposite normals at the targets."""
        return self.solver.startswith("closed-form")

    def at(self, budget: int | None, budget_s: float | None = None) -> Variant:
        """Return the variant with another budget; the closed form has none."""
        return self if self.solver == "closed-form" else replace(self, budget=budget, budget_s=budget_s)

    @property
    def samples(self) -> bool:
        """Whether the method uses a selectable neighbourhood."""
        return self.solver == "descent" and self.method in ("distance", "direction", "contact-kinematics")

    @property
    def slips(self) -> bool:
        """Whether the method has slip matrices to couple."""
        return self.solver != "closed-form" and self.method in ("distance", "direction", "analytical")

    @property
    def every(self) -> int:
        """Stride of the targets that are run."""
        return TARGET_STRIDE if self.method in ("zeroth-order", "finite-difference") else 1

    def derivative(self, seed: int) -> Derivative:
        """Make the derivative method."""
        made = make_derivative(self.method, neighborhood=self.neighborhood, coupling=self.coupling, seed=seed)
        if self.neighborhood == "adaptive" and isinstance(made, Distance | Direction | ContactKinematics):
            made = replace(made, neighborhood=ADAPTIVE)
        # Differentiating the smoothed point, as the paper does, moves that point in the self term.
        return replace(made, smoothed_self=self.coupling == "one-sided") if isinstance(made, Distance) else made

    def queries(self, iterations: np.ndarray) -> np.ndarray:
        """Count the witness queries of tasks: one per iteration, and the queries of the method itself."""
        inner = {"zeroth-order": 2 * ZerothOrder().samples, "finite-difference": 12}
        return iterations * (1 + inner.get(self.method, 0))

    def columns(self) -> dict[str, Any]:
        """Settings as entries of a row."""
        return {
            "method": None if self.solver == "closed-form" else self.method,
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
