"""Forces at the joints of a hand in Drake: servos, springs, dry friction, and the inertia of rotors."""

from __future__ import annotations

from math import inf

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, JointActuator, JointIndex, PdControllerGains

REST_SPEED = 1e-3
"""Speed in rad/s or m/s from which on the dry friction of a joint is fully developed."""


class Actuation:
    """Actuators of a plant; Drake treats them implicitly, so that none is too stiff for the time step."""

    def __init__(self, plant: MultibodyPlant) -> None:
        """Begin without any."""
        self._plant = plant
        self.rest: list[float] = []
        """Set points of the actuators before they are driven, in the order in which they were added."""
        self._last: dict[JointIndex, JointActuator] = {}
        """Last actuator of each joint: it has the inertia of all, as Drake takes a joint's from its last one."""

    def add(
        self,
        joint: Joint,
        stiffness: float = 0.0,
        damping: float = 0.0,
        limit: float = inf,
        *,
        rest: float = 0.0,
        armature: float = 0.0,
    ) -> int:
        """Add an actuator of a joint, which may have several; return its number among the set points.

        Args:
            joint: The joint.
            stiffness: Force per distance to the set point, N/m or N m/rad.
            damping: Force per speed, N s/m or N m s/rad.
            limit: Largest force, N or N m.
            rest: Set point before any other, m or rad.
            armature: Inertia of its rotor about the joint, kg or kg m^2.
        """
        number = len(self.rest)
        actuator = self._plant.AddJointActuator(f"{joint.name()} {number}", joint, limit)
        actuator.set_controller_gains(PdControllerGains(p=stiffness, d=damping))
        actuator.set_default_gear_ratio(1.0)
        if (before := self._last.get(joint.index())) is not None:
            armature += before.default_rotor_inertia()
            before.set_default_rotor_inertia(0.0)
        actuator.set_default_rotor_inertia(armature)
        self._last[joint.index()] = actuator
        self.rest.append(rest)
        return number

    def add_passive(
        self,
        joint: Joint,
        limits: np.ndarray | None,
        *,
        damping: float,
        armature: float,
        stiffness: float,
        rest: float,
        dry_friction: float,
    ) -> None:
        """Give a joint what acts on it without a servo.

        Args:
            joint: The joint.
            limits: Its limits (2,), m or rad; None: none.
            damping: Force per speed, N s/m or N m s/rad.
            armature: Inertia that is added to its own, kg or kg m^2.
            stiffness: That of its spring, N/m or N m/rad.
            rest: Value at which the spring is relaxed, m or rad.
            dry_friction: Largest force of dry friction, N or N m. It is that of a damper so strong that it is fully
                developed from `REST_SPEED` on, up to that force.
        """
        if limits is not None:
            joint.set_position_limits(limits[:1], limits[1:])
        joint.set_default_damping_vector([damping])
        if stiffness:
            self.add(joint, stiffness, rest=rest)
        if dry_friction:
            self.add(joint, damping=dry_friction / REST_SPEED, limit=dry_friction)
        if armature:
            self.add(joint, armature=armature)
