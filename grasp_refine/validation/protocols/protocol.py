"""Protocol of a grasp test in simulation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import radians

from grasp_refine.core.arguments import check_positive
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.protocols.contact_model import DEXGRASPBENCH_CONTACT, ContactModel

AXES = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
"""Directions in which the object is pushed, in its frame: name -> unit vector."""


@dataclass(frozen=True)
class Protocol:
    """Test of a grasp: the hand closes over grasp to squeeze; then the object must stay while pushed, or be lifted.

    The defaults are those of DexGraspBench (Chen et al., "BODex", ICRA 2025, and its public benchmark).
    """

    name: str = "dexgraspbench"
    """Name in results."""
    friction: float = 0.6
    """Sliding friction of all contacts."""
    torsion: float = 0.02
    """Torsional friction of all contacts, in metres."""
    mass: float = 0.1
    """Mass of the object in kg."""
    acceleration: float = 10.0
    """Acceleration in m/s^2 that gives the pushing force times the mass; where the object is lifted, gravity."""
    directions: tuple[str, ...] = tuple(AXES)
    """Directions of the pushes, keys of `AXES`, each from the same state; empty: the object is lifted off a table."""
    lift: float = 0.1
    """Height of the lift in metres; only without pushes."""
    contact: ContactModel = DEXGRASPBENCH_CONTACT
    """Friction of contacts in MuJoCo."""
    timestep: float = 0.004
    """Simulation step in seconds."""
    moves: int = 10
    """Number of set points from pregrasp to grasp, and from grasp to squeeze."""
    steps_per_move: int = 10
    """Simulation steps per set point."""
    checks: int = 10
    """Number of checks whether the object is still held while it is pushed."""
    steps_per_check: int = 50
    """Simulation steps before each check."""
    farthest: float = 0.05
    """Displacement of the object in metres from which on it is lost."""
    steepest: float = radians(15)
    """Rotation of the object in radians from which on it is lost."""
    deepest: float = 0.01
    """Largest penetration of hand and object at the pregrasp, in metres."""

    def __post_init__(self) -> None:
        """Refuse a protocol that cannot be simulated.

        Raises:
            GraspRefineError: names the field, and the valid directions.
        """
        check_positive(self, "friction", "mass", "timestep", "moves", "steps_per_move", "checks", "steps_per_check")
        unknown = [direction for direction in self.directions if direction not in AXES]
        if unknown:
            raise GraspRefineError(f"Protocol: directions are among {', '.join(AXES)}, got {', '.join(unknown)}")

    @property
    def tabletop(self) -> bool:
        """Whether the object is lifted off a table instead of being pushed."""
        return not self.directions

    def with_friction(self, friction: float | None) -> Protocol:
        """Return a copy with another sliding friction, and torsional friction in proportion; None: this protocol."""
        if friction is None:
            return self
        return replace(self, friction=friction, torsion=self.torsion * friction / self.friction)
