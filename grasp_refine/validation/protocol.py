"""How a grasp is tested in simulation: the numbers of the DexGraspBench protocol, as settings that can be named."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import radians
from typing import Literal

from grasp_refine.core.arguments import check_positive
from grasp_refine.core.errors import GraspRefineError

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
    """The hand closes from pregrasp over grasp to squeeze; then the object must stay while it is pushed, or be lifted.

    The defaults are those of DexGraspBench (Chen et al., "BODex", ICRA 2025, and its public benchmark).
    """

    name: str = "force-closure"
    """What results call it."""
    friction: float = 0.6
    """Sliding friction of all contacts."""
    torsion: float = 0.02
    """Torsional friction of all contacts, in metres."""
    mass: float = 0.1
    """Mass of the object in kg."""
    acceleration: float = 10.0
    """The object is pushed with this acceleration times its mass, m/s^2; where it is lifted, gravity."""
    directions: tuple[str, ...] = tuple(AXES)
    """Keys of `AXES`: the pushes, each from the same state; none: the object is lifted off a table instead."""
    lift: float = 0.1
    """How far the hand is lifted, in metres; only where there are no pushes."""
    timestep: float = 0.004
    """Seconds of a simulation step."""
    moves: int = 10
    """Number of set points from pregrasp to grasp, and from grasp to squeeze."""
    steps_per_move: int = 10
    """Simulation steps at each of them."""
    checks: int = 10
    """How often it is checked, while the object is pushed, whether it is still held."""
    steps_per_check: int = 50
    """Simulation steps before each of them."""
    farthest: float = 0.05
    """The object has moved too far from this on, in metres."""
    steepest: float = radians(15)
    """The object has turned too far from this on, in radians."""
    deepest: float = 0.01
    """Hand and object may not penetrate deeper than this at the pregrasp, in metres."""

    def __post_init__(self) -> None:
        """Refuse what cannot be simulated.

        Raises:
            GraspRefineError: names the field, and the directions that there are.
        """
        check_positive(self, "friction", "mass", "timestep", "moves", "steps_per_move", "checks", "steps_per_check")
        unknown = [direction for direction in self.directions if direction not in AXES]
        if unknown:
            raise GraspRefineError(f"Protocol: directions are among {', '.join(AXES)}, got {', '.join(unknown)}")

    @property
    def tabletop(self) -> bool:
        """Whether the object is lifted off a table instead of being pushed."""
        return not self.directions

    def slippery(self, friction: float | None) -> Protocol:
        """The same with another coefficient of sliding friction, and that of torsion in proportion; None: this one."""
        if friction is None:
            return self
        return replace(self, friction=friction, torsion=self.torsion * friction / self.friction)


FORCE_CLOSURE = Protocol()
STRICT = Protocol("strict", friction=0.3, torsion=0.002)
TABLETOP = Protocol("tabletop", directions=(), acceleration=9.81)
SETTINGS = {protocol.name: protocol for protocol in (FORCE_CLOSURE, STRICT, TABLETOP)}
"""The named settings."""

SettingName = Literal["force-closure", "strict", "tabletop"]
"""Their names, for the command line."""
