"""Variants to compare: solvers with derivatives, budgets and batch sizes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine_apps.bench.derivatives import make_derivative

Kind = Literal["targets", "nothing"]
"""Tasks with targets, or without."""

SolverName = Literal["levenberg-marquardt", "descent", "adam"]
DerivativeName = Literal["contact-kinematics", "distance", "direction", "analytical", "rigid"]

SOLVERS: Mapping[str, type[LevenbergMarquardt | Descent | Adam]] = MappingProxyType(
    {"levenberg-marquardt": LevenbergMarquardt, "descent": Descent, "adam": Adam}
)


@dataclass(frozen=True)
class Variant:
    """A solver with its settings; one row of a table for each set and kind of task."""

    solver: SolverName = "levenberg-marquardt"
    """Solver of the refinement."""
    derivative: DerivativeName = "contact-kinematics"
    """Derivative method of the witness points; Levenberg-Marquardt supports contact kinematics only."""
    budget: int | None = None
    """Largest number of iterations; None: default of the solver."""
    batch: int = 64
    """Grasps that are refined at once; with 1, each is a separate call."""
    contacts: int | None = None
    """Number of given fingertips with targets; None: all."""
    pieces: int | None = None
    """Convex pieces into which the object, a convex one, is cut; None: not cut."""
    processes: int | None = None
    """Processes that share the tasks and run at the same time; None: this one."""

    @property
    def iterations(self) -> int:
        """Largest number of iterations of a grasp."""
        return SOLVERS[self.solver].iterations if self.budget is None else self.budget

    @property
    def what(self) -> str:
        """Label of the settings beside the solver, for a progress bar."""
        parts = (f"{value} {name}" for name in ("contacts", "pieces", "processes") if (value := getattr(self, name)))
        return ", ".join([f"batch {self.batch}", *parts])

    @property
    def least_squares(self) -> bool:
        """Whether the solver is Levenberg-Marquardt."""
        return self.solver == "levenberg-marquardt"

    def config(self, seed: int, tolerance: float) -> Config:
        """Make the settings of the refinement."""
        return Config(
            solver=SOLVERS[self.solver](iterations=self.iterations),
            derivative=make_derivative(self.derivative, seed=seed),
            # Solvers are compared by geometry; `bench success` measures whether grasps hold.
            weights=Weights(wrench=0.0),
            tolerance=tolerance,
            width=self.batch,
            seed=seed,
        )

    def columns(self) -> dict[str, Any]:
        """Settings as entries of a row."""
        return {
            "solver": self.solver,
            "derivative": self.derivative,
            "budget": self.iterations,
            "batch": self.batch,
            "contacts": self.contacts,
            "pieces": self.pieces,
            "processes": self.processes or 1,
        }
