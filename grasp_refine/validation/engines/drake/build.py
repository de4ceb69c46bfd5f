"""Translation of the compiled MuJoCo model of a world into Drake's plant."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf

import mujoco
import numpy as np
from pydrake.geometry import GeometryId
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, DiscreteContactApproximation, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Frame,
    Joint,
    PrismaticJoint,
    QuaternionFloatingJoint,
    RevoluteJoint,
    RigidBody,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.framework import Diagram, DiagramBuilder

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_so3, transform
from grasp_refine.hands.linkages.servos import actuator_name
from grasp_refine.validation.engines.drake.actuation import Actuation
from grasp_refine.validation.engines.drake.contacts import let_collide, material, shape_of
from grasp_refine.validation.engines.drake.plant import Plant, rigid
from grasp_refine.validation.engines.drake.tendons import Tendons
from grasp_refine.validation.engines.geom_pairs import touching_pairs
from grasp_refine.validation.engines.mujoco.parameters import Parameters
from grasp_refine.validation.engines.mujoco.world import HAND, HOLDER, OBJECT, World
from grasp_refine.validation.engines.rigid_groups import RigidGroups, pose_of
from grasp_refine.validation.engines.root_joints import ROOT_LAG_S, ROOT_STIFFNESS

STICTION_SPEED_M_S = 1e-4
"""Speed of slip in m/s from which on friction is fully developed: held objects creep by less, 0.2 mm in two seconds."""

NEAR_RIGID_THRESHOLD = 0.1
"""Share of a time step below which the period of a stiff constraint is not resolved but damped (SAP's beta): of the
default, 1, couplings and servos of light fingers would be softer than their gains."""

ROOT_ARMATURE = (100.0, 10.0)
"""Inertia that is added to the root's motion along and about each axis, kg and kg m^2: without it, servos this stiff
are so ill-conditioned that the solver often does not converge."""

POLYNOMIAL_TERMS = 5
"""Number of coefficients of a coupling of joints in MuJoCo; Drake has the first two."""


def build_plant(world: World, parameters: Parameters) -> Plant:
    """Return the plant of a world.

    Raises:
        GraspRefineError: the model has a part that Drake has no counterpart of; names it.
    """
    return _Builder(world, parameters).build()


@dataclass(eq=False)
class _Builder:
    """Plant in the making."""

    world: World
    parameters: Parameters
    _joints: dict[int, Joint] = field(default_factory=dict)
    """Number of a joint in MuJoCo -> joint."""
    _bodies: dict[int, RigidBody] = field(default_factory=dict)
    """First body of a group in MuJoCo -> body."""
    _root_joints: list[Joint] = field(default_factory=list)
    _root_servos: list[int] = field(default_factory=list)

    def build(self) -> Plant:
        """Return the finished plant."""
        self.model = self.world.model
        self.groups = RigidGroups.of(self.model)
        builder = DiagramBuilder()
        self.plant, scene = AddMultibodyPlantSceneGraph(builder, self.model.opt.timestep)
        self._set_options()
        self.hand = self.plant.AddModelInstance(HAND)
        # A hand that is held by an arm carries itself.
        self.plant.set_gravity_enabled(self.hand, False)
        self.actuation = Actuation(self.plant)
        self.tendons = Tendons(self.plant, self.hand, self.actuation)
        self._add_bodies()
        for tendon in range(self.model.ntendon):
            self.tendons.add(self.model, tendon, self._joints)
        servos, gears = self._add_servos()
        self._add_equalities()
        pairs = touching_pairs(self.model)
        geoms = self._add_geoms(pairs)
        self.plant.Finalize()
        let_collide(scene, geoms, pairs)
        return self._located(builder.Build(), servos, gears, geoms)

    def _set_options(self) -> None:
        plant: MultibodyPlant = self.plant
        plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
        plant.set_stiction_tolerance(STICTION_SPEED_M_S)
        plant.set_sap_near_rigid_threshold(NEAR_RIGID_THRESHOLD)
        plant.SetUseSampledOutputPorts(False)
        plant.mutable_gravity_field().set_gravity_vector(self.model.opt.gravity)

    def _add_bodies(self) -> None:
        model, world = self.model, self.world
        self._bodies[0] = self.plant.world_body()
        for body in np.flatnonzero(self.groups.first == np.arange(model.nbody))[1:]:
            name = model.body(body).name
            if name == HOLDER:
                continue
            is_object = body == world.object_body
            instance = self.plant.AddModelInstance(OBJECT) if is_object else self.hand
            scale = self.parameters.mass / world.mass if is_object else 1.0
            added = self.plant.AddRigidBody(name, instance, self._inertia(body, scale))
            self._bodies[int(body)] = added
            joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
            if is_object:
                self.plant.AddJoint(QuaternionFloatingJoint(OBJECT, self.plant.world_frame(), added.body_frame()))
            elif any(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE for joint in joints):
                self._add_root(added)
            else:
                self._add_joints(int(body), added, joints)

    def _inertia(self, body: int, scale: float) -> SpatialInertia:
        mass, centre = self.groups.mass[body], self.groups.centre[body]
        moments = self.groups.inertia[body] / mass + centre @ centre * np.eye(3) - np.outer(centre, centre)
        unit = UnitInertia(*moments[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
        return SpatialInertia(scale * mass, centre, unit, skip_validity_check=True)

    def _massless(self, name: str) -> RigidBody:
        none = SpatialInertia(0.0, np.zeros(3), UnitInertia(0.0, 0.0, 0.0), skip_validity_check=True)
        return self.plant.AddRigidBody(name, self.hand, none)

    def _add_root(self, root: RigidBody) -> None:
        """Hold the root by stiff servos along the axes of a frame, and about them."""
        start = FixedOffsetFrame("start", self.plant.world_frame(), RigidTransform.Identity(), self.hand)
        # The plant keeps a copy of its own.
        frame = self._start = self.plant.AddFrame(start)
        for number in range(6):
            turns, axis = divmod(number, 3)
            body = root if number == 5 else self._massless(f"root {number}")
            kind = RevoluteJoint if turns else PrismaticJoint
            joint = self.plant.AddJoint(kind(f"root {number}", frame, body.body_frame(), np.eye(3)[axis]))
            stiffness = ROOT_STIFFNESS[turns]
            self._root_joints.append(joint)
            self._root_servos.append(
                self.actuation.add(joint, stiffness, ROOT_LAG_S * stiffness, armature=ROOT_ARMATURE[turns])
            )
            frame = body.body_frame()

    def _add_joints(self, body: int, added: RigidBody, joints: range) -> None:
        """Add the joints of a body, one after the other."""
        model = self.model
        parent = model.body_parentid[body]
        above = self._bodies[int(self.groups.first[parent])]
        T = self.groups.T_group_body[parent] @ pose_of(model.body_pos[body], model.body_quat[body])
        for joint in joints:
            name, kind, axis = model.joint(joint).name, mujoco.mjtJoint(model.jnt_type[joint]), model.jnt_axis[joint]
            if kind == mujoco.mjtJoint.mjJNT_BALL:
                raise GraspRefineError(f"engine drake has no ball joints in hands, as '{name}'")
            slides = kind == mujoco.mjtJoint.mjJNT_SLIDE
            child = added if joint == joints[-1] else self._massless(f"{name} carrier")
            at = RigidTransform(model.jnt_pos[joint])
            # The poses of the file are at the reference positions.
            back = -model.qpos0[model.jnt_qposadr[joint]] * axis
            turned = RigidTransform(back) if slides else rigid(transform(exp_so3(back), np.zeros(3)))
            on_parent = self._frame(f"{name} parent", above, rigid(T) @ at @ turned)
            on_child = self._frame(f"{name} child", child, at)
            self._joints[joint] = self.plant.AddJoint(
                (PrismaticJoint if slides else RevoluteJoint)(name, on_parent, on_child, axis)
            )
            above, T = child, np.eye(4)
            dof, at_value = model.jnt_dofadr[joint], model.jnt_qposadr[joint]
            self.actuation.add_passive(
                self._joints[joint],
                model.jnt_range[joint] if model.jnt_limited[joint] else None,
                damping=model.dof_damping[dof],
                armature=model.dof_armature[dof],
                stiffness=model.jnt_stiffness[joint],
                rest=model.qpos_spring[at_value],
                dry_friction=model.dof_frictionloss[dof],
            )

    def _frame(self, name: str, body: RigidBody, X: RigidTransform) -> Frame:
        return self.plant.AddFrame(FixedOffsetFrame(name, body.body_frame(), X, self.hand))

    def _add_servos(self) -> tuple[np.ndarray, np.ndarray]:
        """Add the position servos; return their indices among the set points, and gears."""
        model, servos, gears = self.model, [], []
        for number in range(model.nu):
            target, transmission = int(model.actuator_trnid[number, 0]), mujoco.mjtTrn(model.actuator_trntype[number])
            gear = model.actuator_gear[number, 0]
            if transmission == mujoco.mjtTrn.mjTRN_TENDON:
                joint = self.tendons.joints[target]
                # Of the actuator's force, before its gear.
                own_limit = _largest(model.tendon_actfrclimited[target], model.tendon_actfrcrange[target]) * abs(gear)
            elif transmission in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
                joint = self._joints[target]
                own_limit = _largest(model.jnt_actfrclimited[target], model.jnt_actfrcrange[target])
            else:
                raise GraspRefineError(
                    f"engine drake drives joints and tendons, not '{actuator_name(model, number)}' of the MJCF"
                )
            limit = _largest(model.actuator_forcelimited[number], model.actuator_forcerange[number]) * abs(gear)
            gain = self.parameters.gain * gear**2
            stiffness, damping = gain * model.actuator_gainprm[number, 0], -gain * model.actuator_biasprm[number, 2]
            limit = min(limit, own_limit) * self.parameters.force_limit
            servos.append(self.actuation.add(joint, stiffness, damping, limit))
            gears.append(gear)
        return np.array(servos, dtype=int), np.array(gears)

    def _add_equalities(self) -> None:
        """Tie joints and bodies as the equality constraints of the model do."""
        model, plant = self.model, self.plant
        for number in np.flatnonzero(model.eq_active0):
            kind, data = mujoco.mjtEq(model.eq_type[number]), model.eq_data[number]
            name = model.eq(number).name or f"equality {number}"
            first, second = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
            if name == HOLDER:
                continue
            of_bodies = model.eq_objtype[number] == mujoco.mjtObj.mjOBJ_BODY
            if kind == mujoco.mjtEq.mjEQ_JOINT and second >= 0 and not data[2:POLYNOMIAL_TERMS].any():
                # Values count from the reference positions.
                at = model.qpos0[model.jnt_qposadr[[first, second]]]
                offset = data[0] + at[0] - data[1] * at[1]
                plant.AddCouplerConstraint(self._joints[first], self._joints[second], data[1], offset)
            elif kind == mujoco.mjtEq.mjEQ_CONNECT and of_bodies:
                A, X_A = self._place(first)
                B, X_B = self._place(second)
                plant.AddBallConstraint(A, X_A @ data[:3], B, X_B @ data[3:6])
            elif kind == mujoco.mjtEq.mjEQ_WELD and of_bodies:
                A, X_A = self._place(first)
                B, X_B = self._place(second)
                plant.AddWeldConstraint(A, X_A @ rigid(pose_of(data[3:6], data[6:10])), B, X_B)
            else:
                raise GraspRefineError(
                    f"engine drake has linear couplings of two joints, and bodies tied at a point or welded, but no "
                    f"equality like '{name}'"
                )

    def _place(self, body: int) -> tuple[RigidBody, RigidTransform]:
        """Return the body in Drake that a body of MuJoCo is part of, and its pose there."""
        return self._bodies[int(self.groups.first[body])], rigid(self.groups.T_group_body[body])

    def _add_geoms(self, pairs: list[tuple[int, int]]) -> dict[int, GeometryId]:
        """Add the geoms that can touch any other; return number in MuJoCo -> geometry."""
        model = self.model
        properties = material(self.parameters.friction, self.parameters.contact_time)
        geoms = {}
        for geom in sorted({geom for pair in pairs for geom in pair}):
            body, X_body = self._place(model.geom_bodyid[geom])
            X = X_body @ rigid(pose_of(model.geom_pos[geom], model.geom_quat[geom]))
            name = f"{geom} {model.geom(geom).name}"
            geoms[geom] = self.plant.RegisterCollisionGeometry(body, X, shape_of(model, geom), name, properties)
        return geoms

    def _located(
        self,
        diagram: Diagram,
        servos: np.ndarray,
        gears: np.ndarray,
        geoms: dict[int, GeometryId],
    ) -> Plant:
        plant, model, world = self.plant, self.model, self.world
        helpers = np.eye(plant.num_positions())
        for helper, joint, ratio in self.tendons.terms:
            helpers[helper.position_start(), joint.position_start()] += ratio
        at = plant.GetJointByName(OBJECT).position_start()
        by_address = {int(model.jnt_qposadr[number]): joint for number, joint in self._joints.items()}
        return Plant(
            diagram=diagram,
            plant=plant,
            hand=self.hand,
            start=self._start,
            root=np.array([joint.position_start() for joint in self._root_joints]),
            root_servos=np.array(self._root_servos),
            joints=np.array([by_address[int(at)].position_start() for at in world.joints_at]),
            helpers=helpers,
            servos=servos,
            gear=gears,
            rest=np.array(self.actuation.rest),
            control_range=np.where(
                model.actuator_ctrllimited.astype(bool)[:, None], model.actuator_ctrlrange, [-inf, inf]
            ),
            object=self._bodies[world.object_body],
            object_at=slice(at, at + 7),
            centre=self.groups.centre[world.object_body],
            geoms={identity: geom for geom, identity in geoms.items()},
        )


def _largest(limited: bool | np.bool_ | np.integer, ends: np.ndarray) -> float:
    """Return the larger absolute end of a range (2,); inf where there is none."""
    return float(np.abs(ends).max()) if limited else inf
