"""Bodies, joints and drives of a simulated world, for programs that build their own model of it.

They are taken from the compiled MuJoCo model, so that every program gets the numbers that the verdicts are of: each
convex piece that may touch anything, masses, limits, the stiffness of servos.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf
from typing import Literal

import mujoco
import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import inverse, transform, transform_points
from grasp_refine.hands.files.inertia import Inertia
from grasp_refine.validation.engines.geom_pairs import touching_pairs
from grasp_refine.validation.engines.geom_points import geom_points
from grasp_refine.validation.engines.mujoco.world import HAND, World
from grasp_refine.validation.engines.rigid_groups import pose_of

Kind = Literal["fixed", "revolute", "continuous", "prismatic"]

LEAST_MASS, LEAST_MOMENT = 1e-5, 1e-9
"""Mass (kg) and moment (kg m^2) of links that have none: engines other than MuJoCo need some."""


@dataclass(frozen=True, eq=False)
class Hull:
    """Convex piece of a link."""

    vertices: Float[np.ndarray, "v 3"]
    """Vertices (v, 3) in the frame of the link, metres."""
    faces: Int[np.ndarray, "f 3"]
    """Triangles (f, 3), outwards."""


@dataclass(frozen=True, eq=False)
class BodyLink:
    """Link with the joint that it hangs on."""

    name: str
    parent: str
    """Name of its parent; empty: it is the root."""
    joint: str
    """Name of its joint."""
    kind: Kind
    T_parent_link: Float[np.ndarray, "4 4"]
    """Pose (4, 4) of the link in the frame of its parent where the joint is 0."""
    axis: Float[np.ndarray, " 3"]
    """Axis (3,) of the joint through the link's origin."""
    limits: tuple[float, float]
    """Limits of the joint, m or rad."""
    stiffness: float
    """Stiffness of its servos and springs, N/m or N m/rad; 0: nothing drives it."""
    damping: float
    """Damping likewise, N s/m or N m s/rad."""
    force_limit: float
    """Largest force of its servos, N or N m; infinite: none."""
    armature: float
    """Inertia of its drive, kg or kg m^2."""
    inertia: Inertia
    """Mass and moments, in the frame of the link."""
    hulls: list[Hull] = field(default_factory=list)
    """Convex pieces that may touch anything."""
    leader: tuple[str, float, float] | None = None
    """Joint that this one follows, as multiplier times its value plus offset; None: it follows none."""


@dataclass(frozen=True, eq=False)
class Bodies:
    """Hand and object of a world."""

    links: tuple[BodyLink, ...]
    """Links of the hand, parents first; the first one is its root."""
    object: BodyLink
    """The object, without a joint."""
    separate: frozenset[frozenset[str]]
    """Pairs of links of the hand that may not touch each other."""
    friction: float
    """Sliding friction of all contacts."""
    timestep: float
    """Simulation step, seconds."""
    shift: Float[np.ndarray, " m"]
    """Values (m,) that the joints of `HandModel.joints` have in MuJoCo where they are 0 here."""

    @staticmethod
    def of(world: World) -> Bodies:
        """Return the bodies of a world.

        Raises:
            GraspRefineError: the hand has a joint or servo that URDF and USD have no counterpart of; names it.
        """
        return _Reader(world).read()


@dataclass(frozen=True, eq=False)
class _Reader:
    """Reader of a compiled model."""

    world: World

    def read(self) -> Bodies:
        world, model = self.world, self.world.model
        if world.hand.on_arm is not None or world.scene:
            raise GraspRefineError("hands on arms, and scenes, are exported to mjcf only")
        pairs = touching_pairs(model)
        solid = {geom for pair in pairs for geom in pair}
        links, names = list[BodyLink](), dict[int, str]()
        for body in range(1, model.nbody):
            if model.body(body).name.startswith(f"{HAND}/"):
                made = self._links_of(body, names, solid)
                links += made
                names[body] = made[-1].name
        allowed = {frozenset(names.get(int(model.geom_bodyid[geom]), "") for geom in pair) for pair in pairs}
        bodies = [names[body] for body in names]
        every = {frozenset((a, b)) for a in bodies for b in bodies if a != b}
        of_object = BodyLink(
            "object", "", "", "fixed", np.eye(4), np.eye(3)[0], (0.0, 0.0), 0.0, 0.0, inf, 0.0,
            self._inertia(world.object_body), self._hulls(world.object_body, np.eye(4), solid),
        )  # fmt: skip
        return Bodies(
            tuple(links),
            of_object,
            frozenset(every - allowed),
            world.protocol.friction,
            world.protocol.timestep,
            model.qpos0[world.joints_at],
        )

    def _links_of(self, body: int, names: dict[int, str], solid: set[int]) -> list[BodyLink]:
        """Return the link of a body, after one for each of its joints but the last."""
        model = self.world.model
        name = model.body(body).name.removeprefix(f"{HAND}/")
        parent = names.get(int(model.body_parentid[body]), "")
        joints = [
            joint
            for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
            if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE
        ]
        T, made = pose_of(model.body_pos[body], model.body_quat[body]), list[BodyLink]()
        if not parent:
            T = np.eye(4)
        for number, joint in enumerate(joints):
            at_joint = transform(np.eye(3), model.jnt_pos[joint])
            last = number == len(joints) - 1 and not model.jnt_pos[joint].any()
            label = name if last else f"{name}_{model.joint(joint).name.removeprefix(f'{HAND}/')}"
            made.append(self._link(label, parent, joint, T @ at_joint, body if last else None, solid))
            parent, T = label, inverse(at_joint)
        if not made or made[-1].name != name:
            made.append(self._link(name, parent, None, T, body, solid))
        return made

    def _link(
        self, name: str, parent: str, joint: int | None, T: np.ndarray, body: int | None, solid: set[int]
    ) -> BodyLink:
        model = self.world.model
        inertia = Inertia(LEAST_MASS, np.zeros(3), LEAST_MOMENT * np.eye(3)) if body is None else self._inertia(body)
        hulls = [] if body is None else self._hulls(body, np.eye(4), solid)
        if joint is None:
            return BodyLink(
                name, parent, f"{name}_fixed", "fixed", T, np.eye(3)[0], (0.0, 0.0), 0.0, 0.0, inf, 0.0, inertia, hulls
            )
        kind, label = mujoco.mjtJoint(model.jnt_type[joint]), model.joint(joint).name.removeprefix(f"{HAND}/")
        if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            raise GraspRefineError(f"joint '{label}' turns about three axes, which is exported to mjcf only")
        slides, limited = kind == mujoco.mjtJoint.mjJNT_SLIDE, bool(model.jnt_limited[joint])
        dof, rest = model.jnt_dofadr[joint], model.qpos0[model.jnt_qposadr[joint]]
        low, high = model.jnt_range[joint] - rest if limited else (-inf, inf)
        stiffness, damping, limit = self._drive(joint)
        return BodyLink(
            name, parent, label, "prismatic" if slides else "revolute" if limited else "continuous", T,
            model.jnt_axis[joint].copy(), (float(low), float(high)), stiffness + float(model.jnt_stiffness[joint]),
            damping + float(model.dof_damping[dof]), limit, float(model.dof_armature[dof]), inertia, hulls,
            self._leader(joint),
        )  # fmt: skip

    def _drive(self, joint: int) -> tuple[float, float, float]:
        """Return stiffness, damping and largest force of the servos of a joint; those of tendons by their share."""
        model, world = self.world.model, self.world
        stiffness, damping, limit = 0.0, 0.0, inf
        for number in range(model.nu):
            transmission, target = mujoco.mjtTrn(model.actuator_trntype[number]), int(model.actuator_trnid[number, 0])
            share = float(model.actuator_gear[number, 0])
            if transmission == mujoco.mjtTrn.mjTRN_TENDON:
                wraps = range(model.tendon_adr[target], model.tendon_adr[target] + model.tendon_num[target])
                share *= sum(model.wrap_prm[wrap] for wrap in wraps if model.wrap_objid[wrap] == joint)
            elif transmission != mujoco.mjtTrn.mjTRN_JOINT:
                raise GraspRefineError(f"actuator '{model.actuator(number).name}' is exported to mjcf only")
            elif target != joint:
                continue
            if not share:
                continue
            stiffness += share**2 * float(model.actuator_gainprm[number, 0])
            damping -= share**2 * float(model.actuator_biasprm[number, 2])
            if model.actuator_forcelimited[number]:
                limit = min(limit, abs(share) * float(np.abs(model.actuator_forcerange[number]).max()))
        if model.jnt_actfrclimited[joint]:
            limit = min(limit, float(np.abs(world.model.jnt_actfrcrange[joint]).max()))
        return float(stiffness), float(damping), float(limit)

    def _leader(self, joint: int) -> tuple[str, float, float] | None:
        model = self.world.model
        for number in np.flatnonzero(model.eq_active0).tolist():
            if model.eq_type[number] == mujoco.mjtEq.mjEQ_JOINT and model.eq_obj1id[number] == joint:
                data, other = model.eq_data[number], int(model.eq_obj2id[number])
                if other < 0 or data[2:5].any():
                    raise GraspRefineError(
                        f"joint '{model.joint(joint).name.removeprefix(f'{HAND}/')}' follows another one by a curve, "
                        "which is exported to mjcf only"
                    )
                return model.joint(other).name.removeprefix(f"{HAND}/"), float(data[1]), float(data[0])
        return None

    def _inertia(self, body: int) -> Inertia:
        model = self.world.model
        mass = max(float(model.body_mass[body]), LEAST_MASS)
        moments = np.maximum(model.body_inertia[body], LEAST_MOMENT)
        return Inertia.about(mass, pose_of(model.body_ipos[body], model.body_iquat[body]), np.diag(moments))

    def _hulls(self, body: int, T: np.ndarray, solid: set[int]) -> list[Hull]:
        model = self.world.model
        first, count = model.body_geomadr[body], model.body_geomnum[body]
        return [
            _hull(transform_points(T @ pose_of(model.geom_pos[geom], model.geom_quat[geom]), geom_points(model, geom)))
            for geom in range(first, first + count)
            if geom in solid
        ]


def _hull(points: np.ndarray) -> Hull:
    from scipy.spatial import ConvexHull

    found = ConvexHull(points)
    faces = found.simplices.copy()
    corners = points[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inwards = (normal * found.equations[:, :3]).sum(axis=1) < 0
    faces[inwards] = faces[inwards, ::-1]
    place = np.full(len(points), -1)
    place[found.vertices] = np.arange(len(found.vertices))
    return Hull(points[found.vertices], place[faces])
