"""Demand of a task on the contacts with an object: how hard it is pulled, and how slippery it is."""

from __future__ import annotations

from dataclasses import dataclass

from grasp_refine.objects.object import Object
from grasp_refine.scene.protocols.dexgraspbench import DEXGRASPBENCH
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.task import Task

TOTAL_PRESSURE_N = 30.0
"""Least sum of the pressures of a squeeze, in newtons: it is ample for the protocol `dexgraspbench`."""

GRIP_PRESSURE = 3.6
"""Sum of the pressures of a squeeze over the force on the object, divided by its friction: two opposed contacts hold
with 1, and what they press with has to serve forces in all directions, none of which moves the set points."""


@dataclass(frozen=True)
class Demand:
    """Force on an object and friction of its contacts; by default of the protocol `dexgraspbench`."""

    mass_kg: float = DEXGRASPBENCH.mass
    """Mass of the object in kg."""
    acceleration: float = DEXGRASPBENCH.acceleration
    """Acceleration of pushes, or gravity, in m/s^2."""
    friction: float = DEXGRASPBENCH.friction
    """Coefficient of sliding friction."""

    @staticmethod
    def of(task: Task, obj: Object) -> Demand:
        """Return the demand of a task on an object."""
        protocol = task.test(patches=False)
        return Demand(object_mass(protocol, obj), protocol.acceleration, protocol.friction)

    @property
    def force_n(self) -> float:
        """Force on the object in newtons: its mass times the acceleration."""
        return self.mass_kg * self.acceleration

    @property
    def load(self) -> float:
        """Force, over the force of `dexgraspbench`."""
        return self.force_n / Demand().force_n

    @property
    def grip(self) -> float:
        """Friction, over the friction of `dexgraspbench`: coefficients that forces are planned with change with it."""
        return self.friction / Demand.friction

    @property
    def effort(self) -> float:
        """Pressure that holds the object, over the pressure in `dexgraspbench`."""
        return self.load / self.grip

    @property
    def pressure_n(self) -> float:
        """Sum of the pressures with which a squeeze should hold the object, in newtons."""
        return max(TOTAL_PRESSURE_N, GRIP_PRESSURE * self.force_n / self.friction)


def object_mass(protocol: Protocol, obj: Object) -> float:
    """Return the mass of an object in kg, by the convex pieces where the protocol gives it a density."""
    if protocol.density is None:
        return protocol.mass
    return protocol.object_mass(obj.volume, obj.body.diagonal / 2.0)
