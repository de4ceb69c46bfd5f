"""Fixed tendons in Drake: joints whose value is a weighted sum of other joints' values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, ModelInstanceIndex, PrismaticJoint, RigidBody, SpatialInertia, UnitInertia

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.engines.drake.actuation import Actuation

CHAIN_MASS_KG = 1e-4
"""Mass of each body of a chain; it adds to the inertia of the joints."""

ANCHOR_MASS_KG, ANCHOR_STIFFNESS_N_M, ANCHOR_DAMPING_S = 1.0, 1e5, 0.04
"""Mass, stiffness, and damping over stiffness of the body that holds the ends of the chains."""

ROD_LENGTH_M = 1.0
"""Length of the rod that closes a chain."""

AXIS = np.array([1.0, 0.0, 0.0])
"""Direction of all chains."""


@dataclass(eq=False)
class Tendons:
    """Tendons of a plant.

    Drake's own constraint of tendons is not in its Python interface. A chain of sliding bodies, all along one axis,
    begins with the joint of the length and goes back by each term of the sum, so that its end stays where it is:
    couplers tie the terms to the joints, and a rod of constant length ties the end to an anchor.
    """

    plant: MultibodyPlant
    """Plant to which they are added."""
    hand: ModelInstanceIndex
    """Model instance of the hand."""
    actuation: Actuation
    """Forces at joints."""
    joints: dict[int, Joint] = field(default_factory=dict)
    """Number of a tendon in MuJoCo -> joint whose value is its length."""
    terms: list[tuple[Joint, Joint, float]] = field(default_factory=list)
    """Joint of a chain, joint that it follows, and ratio; entries of one joint of a chain add up."""

    def add(self, model: mujoco.MjModel, number: int, joints: Mapping[int, Joint]) -> None:
        """Add a tendon of a model, given the joints by their numbers in MuJoCo.

        Raises:
            GraspRefineError: it runs over sites.
        """
        own = model.tendon(number).name
        name = f"tendon {number} {own}"
        wraps = range(model.tendon_adr[number], model.tendon_adr[number] + model.tendon_num[number])
        if any(model.wrap_type[wrap] != mujoco.mjtWrap.mjWRAP_JOINT for wrap in wraps):
            raise GraspRefineError(f"engine drake has fixed tendons only, '{own}' runs over sites")
        if not self.joints:
            self._add_anchor()
        body = self._body(name)
        length = self._slide(name, self.plant.world_body(), body)
        for wrap in wraps:
            joint, ratio = joints[int(model.wrap_objid[wrap])], float(model.wrap_prm[wrap])
            after = self._body(f"{name} {joint.name()}")
            term = self._slide(after.name(), body, after)
            self.plant.AddCouplerConstraint(term, joint, -ratio)
            self.terms += [(term, joint, -ratio), (length, joint, ratio)]
            body = after
        self.plant.AddDistanceConstraint(self._anchor, -ROD_LENGTH_M * AXIS, body, np.zeros(3), ROD_LENGTH_M)
        self.joints[number] = length
        self.actuation.add_passive(
            length,
            model.tendon_range[number] if model.tendon_limited[number] else None,
            damping=model.tendon_damping[number],
            armature=model.tendon_armature[number],
            stiffness=model.tendon_stiffness[number],
            rest=float(np.clip(0.0, *model.tendon_lengthspring[number])),
            dry_friction=model.tendon_frictionloss[number],
        )

    def _add_anchor(self) -> None:
        """Add a body that stands still: Drake 1.51 crashes where a rod ends at the world itself."""
        self._anchor = self._body("anchor", ANCHOR_MASS_KG)
        joint = self._slide("anchor", self.plant.world_body(), self._anchor)
        self.actuation.add(joint, ANCHOR_STIFFNESS_N_M, ANCHOR_DAMPING_S * ANCHOR_STIFFNESS_N_M)

    def _body(self, name: str, mass: float = CHAIN_MASS_KG) -> RigidBody:
        point = SpatialInertia(mass, np.zeros(3), UnitInertia(0.0, 0.0, 0.0), skip_validity_check=True)
        return self.plant.AddRigidBody(name, self.hand, point)

    def _slide(self, name: str, parent: RigidBody, child: RigidBody) -> Joint:
        return self.plant.AddJoint(PrismaticJoint(name, parent.body_frame(), child.body_frame(), AXIS))
