"""All settings of a refinement in one value."""

from dataclasses import dataclass, field
from typing import Literal

from grasp_refine.losses import Weights
from grasp_refine.solvers.descent import Descent
from grasp_refine.targets import REACH
from grasp_refine.witness.autograd import Derivative
from grasp_refine.witness.contact_kinematics import ContactKinematics


@dataclass(frozen=True)
class Config:
    """All settings of a refinement."""

    solver: Descent = field(default_factory=Descent)
    """How the hand moves."""
    derivative: Derivative = field(default_factory=ContactKinematics)
    """How witness points are differentiated."""
    weights: Weights = field(default_factory=Weights)
    """How much each term of the loss counts."""
    margin: float = 0.0
    """Contact margin in metres: the gap that contact links should keep."""
    reach: float = REACH
    """Without targets, contact links within this signed distance (metres) of the object are meant to touch it."""
    tolerance: float = 1e-7
    """A grasp has converged when its loss (m^2) is below this; 1e-7 is a third of a millimetre."""
    seed: int = 0
    """Seed of everything that is drawn."""
    dtype: Literal["float64", "float32"] = "float64"
    """Number type of kinematics and losses; collision queries always run in double precision."""
    device: str = "cpu"
    """Torch device of kinematics and losses."""
