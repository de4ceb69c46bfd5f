"""Variants to compare, solvers with derivatives, budgets and batch sizes; named experiments; and sets of assets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType
from typing import Any, Literal

from grasp_refine.refinement.config import Config
from grasp_refine.refinement.solvers.adam import Adam
from grasp_refine.refinement.solvers.descent import Descent
from grasp_refine.refinement.solvers.levenberg_marquardt import LevenbergMarquardt
from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.witness.analytical import Analytical
from grasp_refine.witness.contact_kinematics import ContactKinematics
from grasp_refine.witness.derivative import Derivative
from grasp_refine.witness.direction import Direction
from grasp_refine.witness.distance import Distance
from grasp_refine.witness.rigid import Rigid

Kind = Literal["targets", "nothing"]
"""Tasks with targets, or without."""

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
            derivative=DERIVATIVES[self.derivative](seed),
            # Solvers are compared by geometry; `bench hold` measures whether grasps hold.
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


FIRST_ORDER: tuple[SolverName, ...] = ("descent", "adam")


@dataclass(frozen=True)
class Preset:
    """An experiment."""

    variants: tuple[Variant, ...]
    """Variants to compare."""
    kinds: tuple[Kind, ...] = ("targets", "nothing")
    """Tasks with or without targets."""
    count: int | None = None
    """Tasks of each object and scale; None: all real grasps, and 64 with targets."""
    scenes: int | None = None
    """Number of objects and scales of each set, evenly chosen; None: all."""
    singles: int = 32
    """Tasks of a set that are run one at a time."""
    every_hand: bool = False
    """Whether, by default, all included hands are run, and sampled grasps of others, instead of one hand."""


def _over_time() -> tuple[Variant, ...]:
    quick = [Variant(budget=budget, batch=64) for budget in (5, 10, 20, 50, 100, 200)]
    slow = [
        Variant(solver, budget=budget, batch=64)
        for solver, budget in product(FIRST_ORDER, (50, 100, 200, 500, 1000, 2000))
    ]
    return (*quick, *slow)


PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "targets": Preset(
            tuple(Variant(batch=batch) for batch in (1, 16, 64, 256)),
            kinds=("targets",),
            count=256,
        ),
        "nothing": Preset(
            tuple(Variant(batch=batch) for batch in (1, 16, 64, 256)),
            kinds=("nothing",),
        ),
        "time-to-error": Preset(
            _over_time(),
            kinds=("targets",),
            count=32,
            scenes=3,
        ),
        "contacts": Preset(
            tuple(Variant(contacts=count) for count in (1, 2, 3, 4, 5)),
            kinds=("targets",),
            count=64,
            scenes=2,
            every_hand=True,
        ),
        "pieces": Preset(
            tuple(Variant(pieces=count) for count in (1, 2, 4, 8, 16, 32, 64)),
            kinds=("targets",),
            count=64,
        ),
        "workers": Preset(
            tuple(Variant(processes=count) for count in (1, 2)),
            kinds=("targets",),
            count=256,
        ),
        "smoke": Preset(
            (
                Variant(batch=1),
                Variant(batch=16),
                *(Variant(solver, budget=40, batch=16) for solver in FIRST_ORDER),
            ),
            count=4,
            singles=4,
        ),
    }
)
"""Name -> experiment."""


@dataclass(frozen=True)
class Place:
    """Paths of the parts of a set in a folder of assets, beside grasps/normalised/NAME.npz and objects/."""

    hand: str
    """Path of the URDF."""
    object: str | None = None
    """Path of the object, if it is not in objects/."""
    sampled: int | None = None
    """Number of sampled grasps; None: those of the file."""


PLACES: Mapping[str, Place] = MappingProxyType(
    {
        "bodex_shadow": Place("hands/shadow/shadow_right.urdf"),
        "dexgraspnet_shadow": Place("hands/shadow/shadow_right.urdf"),
        "frogger_allegro": Place("hands/allegro/allegro_right.urdf"),
        "leap_cube": Place("hands/leap/leap_right.urdf", "box:0.075,0.075,0.075"),
        "sampled_barrett": Place("hands/barrett/barrett.urdf", "rounded_box", 16),
        "sampled_robotiq": Place("hands/robotiq3f/robotiq3f.urdf", "rounded_box", 16),
    }
)
"""Name of a set -> its paths."""
