"""Protocol of a grasp test in simulation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import ceil, degrees, inf, pi, radians
from typing import Any, Literal

from grasp_refine.core.arguments import check_positive
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.scene.protocols.contact_model import DEXGRASPBENCH_CONTACT, ContactModel
from grasp_refine.scene.protocols.noise import Noise

AXES = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
"""Directions in which the object is pushed, in its frame: name -> unit vector."""

Palm = Literal["rigid", "soft weld"]
"""Holds of the palm of a hand without an arm: rigid, or DexGraspBench's weld, which gives way under load."""

SHARE_ROUNDING = 1e-9
"""Number of directions by which a required share may exceed an integer: rounding."""

_POSITIVE = (
    *("friction", "mass", "density", "density_size", "largest_mass"),
    *("timestep", "moves", "steps_per_move", "checks", "steps_per_check", "required_share", "required_label"),
)
"""Fields that must be above 0."""


@dataclass(frozen=True)
class Protocol:
    """Test of a grasp: the hand closes over grasp to squeeze; then the object must stay while pushed, or be lifted.

    The defaults are from DexGraspBench (Chen et al., "BODex", ICRA 2025, and its public benchmark), but for the
    palm, which is held rigidly.
    """

    name: str = "dexgraspbench"
    """Name in results."""
    friction: float = 0.6
    """Sliding friction of all contacts."""
    torsion: float = 0.02
    """Torsional friction of all contacts, in metres."""
    mass: float = 0.1
    """Mass of the object in kg; with a density, that gives it."""
    density: float | None = None
    """Density of the object in kg/m^3: with the volume of its pieces it gives its mass. None: the mass is `mass`."""
    density_size: float | None = None
    """Size of an object that has this density, half of the diagonal of its bounding box, in metres; the density of
    others is divided by the square of their size in this unit. None: all have it."""
    largest_mass: float | None = None
    """Largest mass in kg that the density may give; None: any."""
    acceleration: float = 10.0
    """Acceleration in m/s^2 that gives the pushing force times the mass; where the object is lifted, gravity."""
    directions: tuple[str, ...] = tuple(AXES)
    """Directions of the pushes, keys of `AXES`, each from the same state; empty: the object is lifted off a table."""
    required_share: float = 1.0
    """Share of the directions in which a grasp must hold."""
    noise: Noise = Noise()
    """Offsets of the object with which each grasp is tried as well; the label of a grasp is the share that holds."""
    required_label: float = 0.5
    """Label from which on a grasp holds; only with `noise`."""
    lift: float = 0.1
    """Height of the lift in metres; only without pushes."""
    contact: ContactModel = DEXGRASPBENCH_CONTACT
    """Friction of contacts in MuJoCo."""
    multiccd: bool | None = None
    """Whether two convex pieces may touch in several points, or in one, about which flat faces turn, in MuJoCo; None:
    in several where the hand touches in patches (`Hand.patches`)."""
    palm: Palm = "rigid"
    """Hold of the palm in MuJoCo: rigid, whatever hand and object weigh, or the soft weld of DexGraspBench, with which
    it gives way to the object's weight, the more the lighter the hand is. On an arm, the arm holds it."""
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
        check_positive(self, *_POSITIVE)
        if self.density is None and (self.density_size, self.largest_mass) != (None, None):
            raise GraspRefineError("Protocol: density_size and largest_mass are for a density, and there is none")
        for name in ("required_share", "required_label"):
            if getattr(self, name) > 1:
                raise GraspRefineError(f"Protocol: {name} must be at most 1, got {getattr(self, name):g}")
        unknown = [direction for direction in self.directions if direction not in AXES]
        if unknown:
            raise GraspRefineError(f"Protocol: directions are among {', '.join(AXES)}, got {', '.join(unknown)}")

    def required(self, count: int) -> int:
        """Return the number of directions, of `count`, in which a grasp must hold."""
        return ceil(self.required_share * count - SHARE_ROUNDING)

    @property
    def rule(self) -> str:
        """Rule by which a grasp holds, to follow "held", for people."""
        count = len(self.directions)
        least = self.required(count)
        if count < 2:
            rule = f"the {self.directions[0] if self.directions else 'lift'}"
        else:
            rule = f"in {'all' if least == count else f'at least {least}'} of {', '.join(self.directions)}"
        if not self.noise.count:
            return rule
        return f"{rule}, {self._label_rule} with the object up to {self.noise.reach} elsewhere"

    @property
    def _label_rule(self) -> str:
        """Number of trials with offsets that must hold, for people."""
        return f"in at least {100 * self.required_label:g} % of {self.noise.count} trials"

    @property
    def label(self) -> str:
        """Name, with the rule unless all directions must hold, contacts unless they are single points, a soft weld."""
        return ", ".join([self.name, *self._concessions, *self.contact_points, *self._weld])

    @property
    def _concessions(self) -> list[str]:
        """Parts of the rule other than that all directions must hold, for people."""
        least, count = self.required(len(self.directions)), len(self.directions)
        share = [] if least == count else [f"in at least {least} of {count} directions"]
        return [*share, *([f"{self._label_rule} elsewhere"] if self.noise.count else [])]

    @property
    def contact_points(self) -> list[str]:
        """Number of points in which two pieces touch, for people, unless it is one, or the hand decides."""
        return ["faces touch in several points"] if self.multiccd else []

    @property
    def _weld(self) -> list[str]:
        """Hold of the palm, for people, unless it is rigid."""
        return ["palm on a soft weld"] if self.palm == "soft weld" else []

    def bounds(self, share: float = 1.0) -> tuple[str, ...]:
        """Return displacement and rotation from which on the object is lost, times `share`, for people."""
        turn = (f"{share * degrees(self.steepest):g} degrees",) if self.steepest <= pi else ()
        return f"{share * self.farthest * 1e3:g} mm", *turn

    @property
    def seconds(self) -> float:
        """Duration of a push, or of the lift, in seconds."""
        return self.checks * self.steps_per_check * self.timestep

    @property
    def summary(self) -> str:
        """Friction, object, motion and, unless all directions must hold, the rule, for people."""
        if self.density is None:
            weight, force = f"{self.mass * 1e3:g} g", f"{self.mass * self.acceleration:g} N"
        else:
            size = "" if self.density_size is None else f" at a size of {self.density_size * 1e3:g} mm"
            most = "" if self.largest_mass is None else f", at most {self.largest_mass * 1e3:g} g"
            weight, force = f"{self.density:g} kg/m³{size}{most}", f"its mass times {self.acceleration:g} m/s²"
        if self.tabletop:
            motion = f"lifted off a table by {self.lift * 1e2:g} cm in {self.seconds:g} s"
        else:
            motion = f"pushed with {force} in {len(self.directions)} directions for {self.seconds:g} s each"
        rule = [f"held {' and '.join(self._concessions)}"] if self._concessions else []
        parts = [
            f"friction {self.friction:g}",
            f"an object of {weight}",
            motion,
            *self.contact_points,
            *self._weld,
            *rule,
        ]
        return ", ".join(parts)

    @property
    def tabletop(self) -> bool:
        """Whether the object is lifted off a table instead of being pushed."""
        return not self.directions

    def object_mass(self, volume: float, size: float) -> float:
        """Return the mass in kg of an object.

        Args:
            volume: Volume of its pieces, m^3.
            size: Half of the diagonal of its bounding box, metres.
        """
        if self.density is None:
            return self.mass
        density = self.density if self.density_size is None else self.density * (self.density_size / size) ** 2
        return min(density * volume, inf if self.largest_mass is None else self.largest_mass)

    def with_mass(self, mass: float | None) -> Protocol:
        """Return a copy in which all objects have this mass in kg; None: this protocol."""
        if mass is None:
            return self
        return self.changed(mass=mass, density=None, density_size=None, largest_mass=None)

    def with_multiccd(self, multiccd: bool | None) -> Protocol:
        """Return a copy in which two pieces may touch in several points, or in one; None: this protocol."""
        if multiccd is None:
            return self
        return self.changed(multiccd=True) if multiccd else replace(self, multiccd=False)

    def for_contacts(self, patches: bool) -> Protocol:
        """Return the protocol for a hand that touches in patches, or in points, where it leaves `multiccd` to that."""
        return self if self.multiccd is not None else _with_multiccd(self, patches)

    def with_friction(self, friction: float | None) -> Protocol:
        """Return a copy with another sliding friction, and torsional friction in proportion; None: this protocol."""
        if friction is None:
            return self
        return self.changed(friction=friction, torsion=self.torsion * friction / self.friction)

    def changed(self, **values: Any) -> Protocol:
        """Return a copy with other values of its fields, whose palm is rigid unless they are the same values.

        The soft weld belongs to published outcomes, which another test does not reproduce.
        """
        changed = replace(self, **values)
        return changed if changed == self else replace(changed, palm="rigid")


@lru_cache(maxsize=64)
def _with_multiccd(protocol: Protocol, multiccd: bool) -> Protocol:
    """Return `Protocol.with_multiccd`, made once: scenes ask for it often."""
    return protocol.with_multiccd(multiccd)
