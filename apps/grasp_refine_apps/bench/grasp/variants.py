"""What is compared: solvers with their derivatives, budgets and batch sizes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

from grasp_refine.refinement.config import Config
from grasp_refine.refinement.losses import Weights
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.witness.analytical import Analytical
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.direction import Direction
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.rigid import Rigid

SolverName = Literal["levenberg-marquardt", "descent", "adam"]
DerivativeName = Literal["contact-kinematics", "distance", "direction", "analytical", "rigid"]

SOLVERS: Mapping[str, type[LevenbergMarquardt | Descent | Adam]] = MappingProxyType(
    {"levenberg-marquardt": LevenbergMarquardt, "descent": Descent, "adam": Adam}
)
DERIVATIVES: Mapping[str, Callable[[int], Derivative]] = MappingProxyType(
    {
        "contact-kinematics": lambda seed: ContactKinematics(seed=seed),
        "distance": lambda seed: Distance(seed=seed),
        "direction": lambda seed: Direction(seed=seed),
        "analytical": lambda seed: Analytical(),
        "rigid": lambda seed: Rigid(),
    }
)


@dataclass(frozen=True)
class Variant:
    """A solver with its settings; one row of a table for each set and kind of task."""

    solver: SolverName = "levenberg-marquardt"
    """How the hand moves."""
    derivative: DerivativeName = "contact-kinematics"
    """How witness points are differentiated; Levenberg-Marquardt knows contact kinematics only."""
    budget: int | None = None
    """Most iterations; None: those of the solver."""
    batch: int = 64
    """Grasps that are worked on at once; with 1, each is a call of its own."""
    contacts: int | None = None
    """Fingertips that have targets, of those that are given; None: all."""
    pieces: int | None = None
    """Convex pieces into which the object, a convex one, is cut; None: left as it is."""
    processes: int | None = None
    """Processes that share the tasks and run at the same time; None: this one."""

    @property
    def iterations(self) -> int:
        """Most iterations of a grasp."""
        return SOLVERS[self.solver].iterations if self.budget is None else self.budget

    @property
    def what(self) -> str:
        """What a progress bar says beside the solver."""
        parts = (f"{value} {name}" for name in ("contacts", "pieces", "processes") if (value := getattr(self, name)))
        return ", ".join([f"batch {self.batch}", *parts])

    @property
    def least_squares(self) -> bool:
        """Whether the solver is Levenberg-Marquardt."""
        return self.solver == "levenberg-marquardt"

    def config(self, seed: int, tolerance: float) -> Config:
        """The settings of the refinement."""
        return Config(
            solver=SOLVERS[self.solver](iterations=self.iterations),
            derivative=DERIVATIVES[self.derivative](seed),
            # Solvers are compared by geometry; `bench hold` measures whether grasps hold.
            weights=Weights(wrench=0.0),
            tolerance=tolerance,
            width=self.batch,
            seed=seed,
        )

    def columns(self) -> dict[str, Any]:
        """What it is, as entries of a row."""
        return {
            "solver": self.solver,
            "derivative": self.derivative,
            "budget": self.iterations,
            "batch": self.batch,
            "contacts": self.contacts,
            "pieces": self.pieces,
            "processes": self.processes or 1,
        }
