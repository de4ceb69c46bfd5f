"""Factors that nobody knows of the world in which a grasp will be used, with their ranges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, radians
from types import MappingProxyType

from grasp_refine.core.arguments import check_fields
from grasp_refine.core.errors import GraspRefineError

PUSH = "push"
"""Name of the trials in which only the direction of the push is drawn, as it is in all others."""

JOINT = "all"
"""Name of the trials in which all factors are drawn together."""

FIELDS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "pose": ("shift", "turn"),
        "friction": ("friction",),
        "mass": ("mass",),
        "softness": ("contact_time",),
        "cone": ("default_contact",),
        "servos": ("gain", "force_limit"),
        "thickness": ("thickness",),
        "model": ("other_model",),
    }
)
"""Factor -> fields of `Draws` that it sets."""

MEANING: Mapping[str, str] = MappingProxyType(
    {
        JOINT: "all of these at once",
        PUSH: "only the push's direction",
        "pose": "object shifted and turned",
        "friction": "coefficient of friction",
        "mass": "mass of the object",
        "softness": "time constant of contacts",
        "cone": "MuJoCo's default contact",
        "servos": "their stiffness and limits",
        "thickness": "surface out or in",
        "model": "the hand's other model",
    }
)
"""Name of trials -> explanation."""


@dataclass(frozen=True)
class Factors:
    """Ranges of the factors; each range is (smallest, largest)."""

    offset: float = 0.005
    """Largest shift of the object in metres; shifts are uniform in the sphere of this radius."""
    turn: float = radians(5)
    """Largest rotation about the object's centre of mass in radians; rotation vectors are uniform in the sphere."""
    friction: tuple[float, float] = (0.2, 1.0)
    """Sliding friction, uniform; torsional friction is in proportion, as in the protocol."""
    mass: tuple[float, float] = (0.02, 0.5)
    """Mass of the object in kg, uniform in its logarithm."""
    softness: tuple[float, float] = (1.0, 4.0)
    """Factor of the time constant of contacts, uniform in its logarithm."""
    default_contact: float = 0.5
    """Share of draws with MuJoCo's default contact instead of the protocol's."""
    gain: tuple[float, float] = (0.5, 1.5)
    """Factor of the stiffness of all servos, uniform."""
    force_limit: tuple[float, float] = (0.5, 1.0)
    """Factor of the force limits of all servos, uniform."""
    thickness: tuple[float, float] = (-0.001, 0.001)
    """Distance of the object's surface outside of its pieces in metres, uniform."""
    other_model: float = 0.5
    """Share of draws with the hand's other model, where it has one."""

    def __post_init__(self) -> None:
        """Refuse ranges that cannot be drawn from.

        Raises:
            GraspRefineError: names the field.
        """
        check_fields(self)
        for name in ("offset", "turn", "default_contact", "other_model"):
            most = 1.0 if name in ("default_contact", "other_model") else inf
            if not 0 <= getattr(self, name) <= most or getattr(self, name) == inf:
                raise GraspRefineError(f"Factors: {name} must be from 0 to {most:g}, got {getattr(self, name):g}")
        for name in ("friction", "mass", "softness", "gain", "force_limit", "thickness"):
            low, high = getattr(self, name)
            least = -inf if name == "thickness" else 0.0
            if not least < low <= high < inf:
                raise GraspRefineError(
                    f"Factors: {name} must be a range of numbers{' above 0' if least == 0 else ''}, the smaller one "
                    f"first, got {low:g}, {high:g}"
                )
