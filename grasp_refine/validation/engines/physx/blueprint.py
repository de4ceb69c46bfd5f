"""Parts of PhysX's scenes of a world, translated from its compiled MuJoCo model, so that both have the same numbers.

The same in both are bodies and inertias, joints with limits, damping and armature, convex geometry and the pairs that
may touch, stiffness, damping and force limits of servos at joints and tendons, couplings, and the coefficient of
friction. Not the same, as PhysX or its binding has no counterpart:

- contacts with links carry no torque about their normal: PhysX has torsional friction between free bodies alone,
  MuJoCo has 2 cm of it at the friction 0.6 of DexGraspBench (a torque of up to 0.02 m times the normal force);
- joints have no dry friction: fingers that a load pushes back give way to less of it;
- contacts are rigid, where MuJoCo's yield by their impedances, and without restitution;
- hulls have at most 255 faces, and lie up to 0.2 mm inside those of more;
- where joints are coupled, the armature of a joint is inertia of its link, which the joints below it feel as well, and
  the tension at a joint is right within 5 % if the joints have equal inertias, within a third if one has ten times as
  much: PhysX shares it out by inertia as well;
- a force limit counts spring and damper of the joint as well, and an asymmetric force range is widened to its larger
  end.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf

import mujoco
import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import exp_so3, frame_along, inverse, transform
from grasp_refine.hands.linkages.servos import actuator_name
from grasp_refine.validation.engines.geom_pairs import touching_pairs
from grasp_refine.validation.engines.mujoco.parameters import Parameters
from grasp_refine.validation.engines.mujoco.world import HOLDER, World
from grasp_refine.validation.engines.physx.binding import Pose, physx, pose_of_transform
from grasp_refine.validation.engines.physx.drives import Drives
from grasp_refine.validation.engines.physx.shapes import let_collide, material_of, shape_of
from grasp_refine.validation.engines.physx.tendons import Tendon, common_parent, first_below
from grasp_refine.validation.engines.rigid_groups import RigidGroups, pose_of
from grasp_refine.validation.engines.root_joints import ROOT_LAG_S, ROOT_STIFFNESS

ROOT_INERTIA = (100.0, 10.0)
"""Mass and inertia that are added to the root, kg and kg m^2, so that its drives are well-conditioned."""

ROOT_CARRIER = (1.0, 0.01)
"""Mass and inertia of the bodies between the joints of the root, kg and kg m^2."""

CARRIER = (1e-5, 1e-9)
"""Mass and inertia of bodies between joints of one body, kg and kg m^2: PhysX has no body without."""

POLYNOMIAL_TERMS = 5
"""Number of coefficients of a coupling of joints in MuJoCo; the first two are supported."""


@dataclass(frozen=True, eq=False)
class Body:
    """Mass and shapes of a link of the hand, or of the object."""

    mass: float
    """Mass, kg."""
    centre: Pose
    """Centre of mass and principal axes in the frame of the body."""
    moments: Float[np.ndarray, " 3"]
    """Principal moments of inertia (3,), kg m^2."""
    shapes: list[physx.PhysxCollisionShape] = field(default_factory=list)
    """Collision shapes; scenes share them."""


@dataclass(frozen=True, eq=False)
class Link:
    """Link of the hand, with the joint that it hangs on; the first one stands still and has none."""

    body: Body
    """Mass and shapes."""
    parent: int = -1
    """Number of its parent; -1: none."""
    kind: str = "fixed"
    """Type of the joint in PhysX."""
    on_parent: Pose = field(default_factory=Pose)
    """Frame of the link in that of its parent where the joint is 0: at the joint, its x axis along the joint's axis.

    Tendons of PhysX pull along this axis of a link, whatever its joint's is.
    """
    limits: tuple[float, float] = (-inf, inf)
    """Limits of the joint, m or rad."""
    armature: float = 0.0
    """Inertia that is added to the joint's motion, kg or kg m^2."""


@dataclass(frozen=True, eq=False)
class Tie:
    """Two links that are welded together, or at a point."""

    links: tuple[int, int]
    """Their numbers."""
    frames: tuple[Pose, Pose]
    """Frames on them that coincide."""
    welded: bool
    """Whether the frames may not turn in each other either."""


@dataclass(eq=False)
class Blueprint:
    """Parts of all scenes of a world under the same parameters; joint j is that of link j + 1."""

    links: list[Link]
    """Links of the hand: the root's joints, then its bodies, helpers last."""
    drives: Drives
    """Drives of the joints."""
    tendons: list[Tendon]
    """Sums of joint values that are constant."""
    ties: list[Tie]
    """Pairs of links that are tied."""
    helpers: Float[np.ndarray, "j j"]
    """Matrix (j, j) that takes joint values in which those of helpers are 0 to complete ones."""
    joints: Int[np.ndarray, " m"]
    """Numbers (m,) of the hand's joints, in the order of `HandModel.joints`."""
    control_range: Float[np.ndarray, "u 2"]
    """Smallest and largest set point (u, 2) of MuJoCo's actuators."""
    object: Body
    """The object."""
    fixed: list[physx.PhysxCollisionShape]
    """Shapes of the world."""
    geoms: dict[physx.PhysxCollisionShape, int]
    """Shape -> number of the geom in MuJoCo."""
    gravity: Float[np.ndarray, " 3"]
    """Acceleration (3,) of the object, m/s^2; a hand that is held by an arm carries itself."""
    timestep: float
    """Simulation step, seconds."""


def blueprint_of(world: World, parameters: Parameters) -> Blueprint:
    """Return the blueprint of the scenes of a world.

    Raises:
        GraspRefineError: the model has a part that PhysX has no counterpart of; names it.
    """
    return _Builder(world, parameters).build()


@dataclass(eq=False)
class _Builder:
    """Blueprint in the making."""

    world: World
    parameters: Parameters
    _links: list[Link] = field(default_factory=list)
    _number_of_joint: dict[int, int] = field(default_factory=dict)
    """Number of a joint in MuJoCo -> number of its link."""
    _place_of_body: dict[int, tuple[int, np.ndarray]] = field(default_factory=dict)
    """First body of a group in MuJoCo -> number of its link, and pose (4, 4) of the link in the body's frame."""
    _number_of_tendon: dict[int, int] = field(default_factory=dict)
    """Number of a tendon in MuJoCo -> number of the helper whose value is its length."""
    _terms: dict[int, dict[int, float]] = field(default_factory=dict)
    """Number of a helper -> weight of each link's joint in its value."""
    _passive: list[tuple[int, float, float, float]] = field(default_factory=list)
    """Link, stiffness, damping and rest of what acts on its joint without a servo."""

    def build(self) -> Blueprint:
        """Return the finished blueprint."""
        model = self.model = self.world.model
        self.groups = RigidGroups.of(model)
        self._add_root_joints()
        for body in np.flatnonzero(self.groups.first == np.arange(model.nbody))[1:]:
            if body != self.world.object_body and model.body(body).name != HOLDER:
                self._add_body(int(body))
        self._axes = self._axes_of_joints()
        tendons = self._couplings() + [self._tendon(number) for number in range(model.ntendon)]
        drives = self._drives()
        helpers = np.eye(len(self._links) - 1)
        for helper, terms in self._terms.items():
            for link, weight in terms.items():
                helpers[helper - 1, link - 1] += weight
        object, fixed, geoms = self._add_shapes()
        by_address = {int(model.jnt_qposadr[joint]): link for joint, link in self._number_of_joint.items()}
        return Blueprint(
            links=self._links,
            drives=drives,
            tendons=tendons,
            ties=self._ties(),
            helpers=helpers,
            joints=np.array([by_address[int(at)] - 1 for at in self.world.joints_at]),
            control_range=np.where(
                model.actuator_ctrllimited.astype(bool)[:, None], model.actuator_ctrlrange, [-inf, inf]
            ),
            object=object,
            fixed=fixed,
            geoms=geoms,
            gravity=model.opt.gravity.copy(),
            timestep=float(model.opt.timestep),
        )

    @cached_property
    def _is_coupled(self) -> bool:
        """Whether tendons of PhysX couple joints: these know of inertia of links, but of no armature."""
        model = self.model
        return bool(model.ntendon or (model.eq_type[model.eq_active0] == mujoco.mjtEq.mjEQ_JOINT).any())

    def _add_root_joints(self) -> None:
        """Hold the root by stiff drives along the axes of a frame, and about them; the last joint is its own."""
        carrier = Body(ROOT_CARRIER[0], Pose(), np.full(3, ROOT_CARRIER[1]))
        self._links.append(Link(carrier))
        above = np.eye(4)
        for number in range(6):
            turns, axis = divmod(number, 3)
            frame = transform(frame_along(np.eye(3)[axis]), np.zeros(3))
            kind = "revolute_unwrapped" if turns else "prismatic"
            stiffness, at = ROOT_STIFFNESS[turns], pose_of_transform(inverse(above) @ frame)
            self._links.append(Link(carrier, number, kind, at))
            self._passive.append((number + 1, stiffness, ROOT_LAG_S * stiffness, 0.0))
            above = frame

    def _body(
        self,
        body: int,
        T_body_link: np.ndarray,
        mass: float = 0.0,
        inertia: np.ndarray | float = 0.0,
        scale: float = 1.0,
    ) -> Body:
        """Return the mass of the group of a body times `scale`, with more mass and inertia (3, 3) about its centre."""
        moments, axes = np.linalg.eigh(scale * self.groups.inertia[body] + inertia)
        axes[:, 0] *= np.linalg.det(axes)
        T = inverse(T_body_link) @ transform(axes, self.groups.centre[body])
        return Body(scale * float(self.groups.mass[body]) + mass, pose_of_transform(T), moments)

    def _add_body(self, body: int) -> None:
        """Add a body of the hand with its joints, one after the other."""
        model = self.model
        joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        if any(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE for joint in joints):
            # The frame of the last joint of the root, about z.
            T_body_link = transform(frame_along(np.eye(3)[2]), np.zeros(3))
            own = self._body(body, T_body_link, ROOT_INERTIA[0], ROOT_INERTIA[1] * np.eye(3))
            self._links[-1] = replace(self._links[-1], body=own)
            self._place_of_body[body] = len(self._links) - 1, T_body_link
            return
        parent = model.body_parentid[body]
        above, T_parent_link = self._place_of_body[int(self.groups.first[parent])]
        # Pose of the body at reference positions in the frame of the link above.
        T = self.groups.T_group_body[parent] @ pose_of(model.body_pos[body], model.body_quat[body])
        T = inverse(T_parent_link) @ T
        for joint in joints:
            name, kind, axis = model.joint(joint).name, mujoco.mjtJoint(model.jnt_type[joint]), model.jnt_axis[joint]
            if kind == mujoco.mjtJoint.mjJNT_BALL:
                raise GraspRefineError(f"engine physx has no ball joints in hands, as '{name}': use engine mujoco")
            slides, limited = kind == mujoco.mjtJoint.mjJNT_SLIDE, bool(model.jnt_limited[joint])
            T_body_link = transform(frame_along(axis), model.jnt_pos[joint])
            # The poses of the file are at the reference positions.
            back = -model.qpos0[model.jnt_qposadr[joint]] * np.eye(3)[0]
            moved = transform(np.eye(3), back) if slides else transform(exp_so3(back), np.zeros(3))
            dof, number = model.jnt_dofadr[joint], len(self._links)
            armature = float(model.dof_armature[dof])
            if joint != joints[-1]:
                own = Body(CARRIER[0], Pose(), np.full(3, CARRIER[1]))
            elif self._is_coupled:
                mass, inertia = (armature, 0.0) if slides else (0.0, armature * np.outer(axis, axis))
                own, armature = self._body(body, T_body_link, mass, inertia), 0.0
            else:
                own = self._body(body, T_body_link)
            self._links.append(
                Link(
                    own,
                    above,
                    "prismatic" if slides else ("revolute" if limited else "revolute_unwrapped"),
                    pose_of_transform(T @ T_body_link @ moved),
                    tuple(model.jnt_range[joint]) if limited else (-inf, inf),
                    armature,
                )
            )
            rest = model.qpos_spring[model.jnt_qposadr[joint]]
            self._passive.append((number, model.jnt_stiffness[joint], model.dof_damping[dof], rest))
            self._number_of_joint[joint] = above = number
            T = inverse(T_body_link)
        self._place_of_body[body] = above, T_body_link

    def _couplings(self) -> list[Tendon]:
        """Return the tendons in place of linear couplings of joints."""
        model, tendons = self.model, []
        for number in np.flatnonzero(model.eq_active0).tolist():
            if model.eq_type[number] == mujoco.mjtEq.mjEQ_JOINT:
                first, second, data = int(model.eq_obj1id[number]), int(model.eq_obj2id[number]), model.eq_data[number]
                if second < 0 or data[2:POLYNOMIAL_TERMS].any():
                    raise self._no_such_equality(number)
                # Values count from the reference positions.
                at = model.qpos0[model.jnt_qposadr[[first, second]]]
                a, b = self._number_of_joint[first], self._number_of_joint[second]
                length = data[0] + at[0] - data[1] * at[1]
                tendons.append(self._sum({a: 1.0, b: -data[1]}, length, model.joint(first).name))
        return tendons

    def _tendon(self, number: int) -> Tendon:
        """Add a helper whose joint has the length of a fixed tendon of MuJoCo; return the tendon that makes it so."""
        model, name = self.model, self.model.tendon(number).name
        wraps = range(model.tendon_adr[number], model.tendon_adr[number] + model.tendon_num[number])
        if any(model.wrap_type[wrap] != mujoco.mjtWrap.mjWRAP_JOINT for wrap in wraps):
            raise GraspRefineError(f"engine physx has fixed tendons only, '{name}' runs over sites: use engine mujoco")
        terms = {self._number_of_joint[int(model.wrap_objid[wrap])]: float(model.wrap_prm[wrap]) for wrap in wraps}
        moved = [model.dof_M0[model.jnt_dofadr[model.wrap_objid[wrap]]] for wrap in wraps]
        helper = len(self._links)
        first = first_below(common_parent(list(terms), self._parents), min(terms), self._parents)
        beside, inertia = self._links[first], min(moved) + model.tendon_armature[number]
        kind = beside.kind if beside.kind == "prismatic" else "revolute_unwrapped"
        limits = tuple(model.tendon_range[number]) if model.tendon_limited[number] else (-inf, inf)
        body = Body(inertia if kind == "prismatic" else CARRIER[0], Pose(), np.full(3, inertia))
        self._links.append(Link(body, beside.parent, kind, beside.on_parent, limits))
        self._axes = np.vstack([self._axes, self._axes[first]])
        rest = float(np.clip(0.0, *model.tendon_lengthspring[number]))
        self._passive.append((helper, model.tendon_stiffness[number], model.tendon_damping[number], rest))
        self._number_of_tendon[number], self._terms[helper] = helper, terms
        return self._sum({**terms, helper: -1.0}, 0.0, name)

    def _sum(self, terms: dict[int, float], length: float, name: str) -> Tendon:
        """Return the tendon that holds a sum constant."""
        return Tendon.of(terms, length, self._parents, self._axes, name)

    @property
    def _parents(self) -> list[int]:
        """Numbers of the parents of all links."""
        return [link.parent for link in self._links]

    def _axes_of_joints(self) -> Float[np.ndarray, "l 6"]:
        """Return the axes (l, 6) of all joints at the reference positions, in the world; 0 for those of the root."""
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        axes = np.zeros((len(self._links), 6))
        for joint, link in self._number_of_joint.items():
            turns = self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
            axes[link, 3 * turns : 3 * turns + 3] = data.xaxis[joint]
        return axes

    def _drives(self) -> Drives:
        """Return the drives of all joints: springs, dampers and position servos."""
        model, gain = self.model, self.parameters.gain
        drives = Drives(len(self._links) - 1, model.nu)
        for number in range(model.nu):
            target, transmission = int(model.actuator_trnid[number, 0]), mujoco.mjtTrn(model.actuator_trntype[number])
            gear = float(model.actuator_gear[number, 0])
            if transmission == mujoco.mjtTrn.mjTRN_TENDON:
                link = self._number_of_tendon[target]
                # Of the actuator's force, before its gear.
                own = _largest(model.tendon_actfrclimited[target], model.tendon_actfrcrange[target]) * abs(gear)
            elif transmission in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
                link = self._number_of_joint[target]
                own = _largest(model.jnt_actfrclimited[target], model.jnt_actfrcrange[target])
            else:
                raise GraspRefineError(
                    f"engine physx drives joints and tendons, not '{actuator_name(model, number)}' of the MJCF: use "
                    f"engine mujoco"
                )
            limit = _largest(model.actuator_forcelimited[number], model.actuator_forcerange[number]) * abs(gear)
            stiffness = gain * gear**2 * model.actuator_gainprm[number, 0]
            damping = -gain * gear**2 * model.actuator_biasprm[number, 2]
            drives.add_servo(link - 1, number, stiffness, damping, min(limit, own) * self.parameters.force_limit, gear)
        for link, stiffness, damping, rest in self._passive:
            drives.add_spring(link - 1, stiffness, damping, rest)
        for joint in np.flatnonzero((drives.servos > 1) & np.isfinite(drives.limit)):
            name = next(model.joint(at).name for at, link in self._number_of_joint.items() if link == joint + 1)
            raise GraspRefineError(
                f"engine physx has one drive for a joint, '{name}' has {drives.servos[joint]} servos with limits of "
                f"their own: use engine mujoco or drake"
            )
        return drives

    def _ties(self) -> list[Tie]:
        """Return the pairs of links that equality constraints of bodies tie."""
        model, ties = self.model, []
        for number in np.flatnonzero(model.eq_active0).tolist():
            kind, data = mujoco.mjtEq(model.eq_type[number]), model.eq_data[number]
            if model.eq(number).name == HOLDER or kind == mujoco.mjtEq.mjEQ_JOINT:
                continue
            welded = kind == mujoco.mjtEq.mjEQ_WELD
            of_bodies = model.eq_objtype[number] == mujoco.mjtObj.mjOBJ_BODY
            if not of_bodies or not (welded or kind == mujoco.mjtEq.mjEQ_CONNECT):
                raise self._no_such_equality(number)
            bodies = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
            if not all(int(self.groups.first[body]) in self._place_of_body for body in bodies):
                raise self._no_such_equality(number)
            if welded:
                T = pose_of(data[3:6], data[6:10]), np.eye(4)
            else:
                T = transform(np.eye(3), data[:3]), transform(np.eye(3), data[3:6])
            places = [self._place_of_body[int(self.groups.first[body])] for body in bodies]
            frames = [
                pose_of_transform(inverse(T_body_link) @ self.groups.T_group_body[body] @ own)
                for body, own, (_, T_body_link) in zip(bodies, T, places, strict=True)
            ]
            ties.append(Tie((places[0][0], places[1][0]), (frames[0], frames[1]), welded))
        return ties

    def _no_such_equality(self, number: int) -> GraspRefineError:
        name = self.model.eq(number).name or f"equality {number}"
        return GraspRefineError(
            f"engine physx has linear couplings of two joints, and bodies tied at a point or welded, but no equality "
            f"like '{name}': use engine mujoco"
        )

    def _add_shapes(self) -> tuple[Body, list[physx.PhysxCollisionShape], dict[physx.PhysxCollisionShape, int]]:
        """Give links the shapes that can touch any other; return object, shapes of the world, and their geoms."""
        model, world, groups = self.model, self.world, self.groups
        pairs = touching_pairs(model)
        material = material_of(self.parameters.friction)
        shapes: list[physx.PhysxCollisionShape | None] = [None] * model.ngeom
        object = self._body(world.object_body, np.eye(4), scale=self.parameters.mass / world.mass)
        fixed: list[physx.PhysxCollisionShape] = []
        for geom in sorted({geom for pair in pairs for geom in pair}):
            body = int(model.geom_bodyid[geom])
            first = int(groups.first[body])
            link, T_body_link = self._place_of_body.get(first, (0, np.eye(4)))
            T = groups.T_group_body[body] @ pose_of(model.geom_pos[geom], model.geom_quat[geom])
            shape = shapes[geom] = shape_of(model, geom, inverse(T_body_link) @ T, material)
            if first == world.object_body:
                object.shapes.append(shape)
            elif first == 0:
                fixed.append(shape)
            else:
                self._links[link].body.shapes.append(shape)
        let_collide(shapes, pairs)
        return object, fixed, {shape: geom for geom, shape in enumerate(shapes) if shape is not None}


def _largest(limited: bool | np.bool_ | np.integer, ends: np.ndarray) -> float:
    """Return the larger absolute end of a range (2,); inf where there is none."""
    return float(np.abs(ends).max()) if limited else inf
