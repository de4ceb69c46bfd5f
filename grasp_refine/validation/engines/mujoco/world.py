"""World of a simulation: one hand on a free root or an arm, one object, compiled once for any number of grasps."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np

from grasp_refine.core.arguments import check_kind
from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.hands.files.inertia import Inertia
from grasp_refine.hands.files.mujoco_messages import compiled, one_line, unlogged
from grasp_refine.hands.linkages.servos import moments
from grasp_refine.objects.object import Object
from grasp_refine.scene.demand import object_mass
from grasp_refine.scene.environment import Environment
from grasp_refine.scene.plane import Plane
from grasp_refine.scene.protocols.contact_model import Cone
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.task import Task
from grasp_refine.validation.engines.mujoco.geoms import add_piece
from grasp_refine.validation.engines.mujoco.hand_model import HandModel
from grasp_refine.validation.engines.simulations import OBJECT_GEOM, OTHER_GEOM

UP = np.array([0.0, 0.0, 1.0])
"""Direction in which an object is lifted off a table."""

OBJECT, HAND, HOLDER, TABLE = "object", "hand", "holder", "table"
"""Names of bodies and free joints; the hand's is also the prefix of its names."""

CONES: Mapping[Cone, mujoco.mjtCone] = MappingProxyType(
    {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}
)
"""Friction cones as MuJoCo names them."""

SCENE = "scene/"
"""Prefix of the names of bodies around the object."""


ALL_COLLISION_BITS = -1
"""All 32 collision bits: object and table touch all that can touch anything, whatever bits the hand's file has."""

ROLLING_FRICTION = 1e-4
"""Rolling friction, which contacts of dimension 4 do not use; MuJoCo requires a value."""
HAND_SOLREF, HAND_SOLIMP = (0.005, 1.0), (0.5, 0.99, 1e-4, 0.5, 2.0)
"""Solver parameters of contacts of the hand."""
SOFT_WELD_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)
"""Solver parameters of DexGraspBench's weld of the hand's root to its holder: it yields by 36 um kg/N over the mass."""
RIGID_WELD_SOLIMP = (0.999, 0.9999, 0.001, 0.5, 2.0)
"""Solver parameters of a weld that hardly yields, to a root of `ROOT_ARMATURE`."""
ROOT_ARMATURE = 1.0
"""Inertia in kg and kg m^2 that is added to the root of a rigid palm. A weld is as stiff as what it holds is heavy:
with this, 20 N and 1 N m move no palm by more than 0.02 mm and 0.001 degrees, and all follow their set points alike.
A root in the holder itself would not yield at all, but has no velocity in MuJoCo, so that friction does not lift."""


@dataclass(frozen=True, eq=False)
class World:
    """Compiled model with indices of its parts; the object's frame is the world's where the object starts."""

    spec: mujoco.MjSpec
    """Specification of the model, for export."""
    model: mujoco.MjModel
    """Compiled model; it is never changed."""
    hand: HandModel
    """Hand in the model."""
    object: str
    """Name of the object."""
    protocol: Protocol
    """Protocol of the model."""
    root_at: int | None
    """Index in qpos of the pose (7,) of the hand's root; None: it is the base of an arm, fixed to the holder."""
    object_at: int
    """Index in qpos of the pose (7,) of the object."""
    joints_at: Int[np.ndarray, " m"]
    """Indices (m,) in qpos of the values of the hand's joints, in the order of `HandModel.joints`."""
    object_body: int
    """Number of the object's body."""
    mass: float
    """Mass of the object, kg."""
    control: Float[np.ndarray, "u m"]
    """Matrix (u, m) that takes joint values (m,) to the set points of the u actuators at which they rest."""
    links: tuple[str, ...]
    """Names of the L links with collision geometry."""
    link_of_geom: Int[np.ndarray, " g"]
    """Index of the link of each geom (g,), or `OBJECT_GEOM`, or `OTHER_GEOM`, such as the table's."""
    up: Float[np.ndarray, " 3"] = field(default_factory=UP.copy)
    """Unit vector (3,) against gravity, along which an object is lifted."""
    scene: str = ""
    """Name of the scene around the object; empty: there is none."""
    neighbours: tuple[str, ...] = ()
    """Names of the V bodies around the object that can be pushed."""
    neighbours_at: Int[np.ndarray, " V"] = field(default_factory=lambda: np.zeros(0, dtype=int))
    """Indices (V,) in qpos of their poses (7,)."""

    @cached_property
    def hand_dofs(self) -> Int[np.ndarray, " d"]:
        """Indices (d,) in qvel of all joints of the hand, without the free one of its root."""
        of = [self.model.joint(joint).name for joint in self.model.dof_jntid]
        return np.array([dof for dof, name in enumerate(of) if name.startswith(f"{HAND}/")], dtype=int)

    def __repr__(self) -> str:
        return f"World({self.object} in a hand of {len(self.links)} links, protocol {self.protocol.name})"


@stage("simulating")
def build_world(
    hand: HandModel,
    obj: Object,
    task: Task,
) -> World:
    """Return the world in which a task is simulated with a hand and an object.

    Args:
        hand: The hand; it is copied.
        obj: The object, with all its convex pieces.
        task: What is simulated: its protocol, whose `multiccd` the hand decides where it leaves that open. An object
            that is lifted stands on the table, or among the bodies of the scene, of which movable ones can be pushed;
            by default on a plane under its lowest point.

    Raises:
        GraspRefineError: MuJoCo cannot compile it, with its message; or no geometry of the hand can touch the
            object; or an argument of another type.
    """
    check_kind("hand", hand, HandModel)
    check_kind("obj", obj, Object)
    check_kind("task", task, Task)
    protocol = task.test(patches=hand.patches)
    # Pushes act on an object in empty space.
    around = task.environment if protocol.tabletop else None
    spec = mujoco.MjSpec()
    spec.modelname = f"{obj.name} in a hand"
    spec.compiler.degree = False
    spec.copy_during_attach = True
    up = UP if around is None else around.up
    _set_options(spec, protocol, up)
    mass = _add_object(spec, obj, protocol)
    _add_hand(spec, hand, protocol)
    if around is not None:
        _add_environment(spec, around, protocol)
    elif protocol.tabletop and (table := task.plane_under(obj)) is not None:
        _add_table(spec, table)
    for geom in spec.geoms:
        geom.condim, geom.friction = 4, [protocol.friction, protocol.torsion, ROLLING_FRICTION]
    try:
        model = compiled(spec)
    except ValueError as error:
        raise GraspRefineError(f"MuJoCo cannot simulate {obj.name} in this hand: {_error_with_advice(error)}") from None
    return replace(_located(spec, model, hand, obj.name, protocol, mass), up=up, **_neighbours(model, around))


def _error_with_advice(error: ValueError) -> str:
    """Return the message of MuJoCo, with the possible cause if it is about mass or size of the object."""
    text = one_line(error)
    if re.search(rf"\b{OBJECT}(_\d+)?\b", text) and re.search(r"\b(mass|inertia|volume|size)\b", text):
        return f"{text}; `mass` or `scale` may be too small for it"
    return text


def _set_options(spec: mujoco.MjSpec, protocol: Protocol, up: np.ndarray) -> None:
    option, disable = spec.option, mujoco.mjtDisableBit
    option.timestep = protocol.timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = CONES[protocol.contact.cone]
    option.noslip_iterations = protocol.contact.noslip_iterations
    option.impratio = protocol.contact.impratio
    option.gravity = -protocol.acceleration * up if protocol.tabletop else np.zeros(3)
    # A simulation that diverges must not be reset to its start, where it would look like one that holds.
    option.disableflags |= disable.mjDSBL_AUTORESET
    if not protocol.multiccd:
        # As in the MuJoCo that DexGraspBench was published with: 4 has up to four contacts for a pair.
        option.disableflags |= disable.mjDSBL_MULTICCD


def _add_object(spec: mujoco.MjSpec, obj: Object, protocol: Protocol) -> float:
    """Add the object and return its mass in kg."""
    body = spec.worldbody.add_body(name=OBJECT)
    body.add_freejoint(name=OBJECT)
    volumes = np.array([Inertia.of([piece], density=1.0).mass for piece in obj.body.pieces])
    mass = object_mass(protocol, obj)
    for number, (piece, share) in enumerate(zip(obj.body.pieces, volumes / volumes.sum(), strict=True)):
        geom = add_piece(spec, body, piece, f"{OBJECT}_{number}")
        geom.mass = mass * share
        geom.contype = geom.conaffinity = ALL_COLLISION_BITS
    return mass


def _add_hand(spec: mujoco.MjSpec, hand: HandModel, protocol: Protocol) -> None:
    prefix = f"{HAND}/"
    holder = spec.worldbody.add_body(name=HOLDER, mocap=True)
    stands = hand.on_arm is not None
    with unlogged():
        spec.attach(hand.spec, prefix=prefix, frame=(holder if stands else spec.worldbody).add_frame())
    root = spec.body(prefix + hand.root)
    root.pos, root.quat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    if not stands:
        free = root.add_freejoint(name=HAND)
    for body in spec.bodies:
        if body.name.startswith(prefix):
            # A hand that is held by an arm carries itself.
            body.gravcomp = 1.0 if protocol.tabletop else 0.0
            for geom in body.geoms:
                geom.solref, geom.solimp = HAND_SOLREF, HAND_SOLIMP
    if stands:
        return
    weld = spec.add_equality(
        name=HOLDER,
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=HOLDER,
        name2=root.name,
    )
    # Anchor (3), relative position (3) and rotation (4), and how much a torque counts against a force.
    weld.data[:11] = [0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1]
    weld.solimp = SOFT_WELD_SOLIMP
    if protocol.palm == "rigid":
        free.armature, weld.solimp = ROOT_ARMATURE, RIGID_WELD_SOLIMP


def _add_table(spec: mujoco.MjSpec, plane: Plane) -> None:
    normal = np.asarray(plane.normal)
    geom = spec.worldbody.add_geom(name=TABLE, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 0.05])
    geom.pos = plane.offset * normal
    geom.alt.type, geom.alt.zaxis = mujoco.mjtOrientation.mjORIENTATION_ZAXIS, normal
    geom.contype = geom.conaffinity = ALL_COLLISION_BITS


def _add_environment(spec: mujoco.MjSpec, environment: Environment, protocol: Protocol) -> None:
    """Add the bodies around the object: fixed ones to the world, movable ones with free joints and their masses."""
    for one, T in zip(environment.bodies, environment.T_object_body, strict=True):
        position, turn = np.split(pose_from_transform(T), [3])
        body = spec.worldbody.add_body(name=SCENE + one.name, pos=position, quat=turn)
        volumes = np.array([Inertia.of([piece], density=1.0).mass for piece in one.body.pieces])
        mass = 0.0
        if one.movable:
            body.add_freejoint(name=SCENE + one.name)
            size = one.body.diagonal / 2.0
            mass = one.mass if one.mass is not None else protocol.object_mass(float(volumes.sum()), size)
        for number, (piece, share) in enumerate(zip(one.body.pieces, volumes / volumes.sum(), strict=True)):
            geom = add_piece(spec, body, piece, f"{SCENE}{one.name}/{number}")
            geom.mass = mass * share
            geom.contype = geom.conaffinity = ALL_COLLISION_BITS


def _neighbours(model: mujoco.MjModel, environment: Environment | None) -> dict[str, Any]:
    """Return the fields of `World` on the bodies around the object."""
    if environment is None:
        return {}
    names = tuple(one.name for one in environment.bodies if one.movable)
    at = [int(model.joint(SCENE + name).qposadr[0]) for name in names]
    return {"scene": environment.name, "neighbours": names, "neighbours_at": np.array(at, dtype=int)}


def _located(
    spec: mujoco.MjSpec, model: mujoco.MjModel, hand: HandModel, name: str, protocol: Protocol, mass: float
) -> World:
    prefix = f"{HAND}/"
    body_names = [model.body(i).name for i in range(model.nbody)]
    object_body = body_names.index(OBJECT)
    # As the object has all bits, these are what it can touch.
    touching = (model.geom_contype | model.geom_conaffinity) != 0
    owners = [
        hand.links.get(body.removeprefix(prefix), body.removeprefix(prefix)) if body.startswith(prefix) else None
        for body in (body_names[b] for b in model.geom_bodyid)
    ]
    links = tuple(dict.fromkeys(owner for owner, solid in zip(owners, touching, strict=True) if owner and solid))
    if not links:
        raise GraspRefineError(
            f"no geometry of this hand can touch {name}: it has none, or all of it has contype and conaffinity 0"
        )
    link_of_geom = [
        links.index(owner) if owner in links else (OBJECT_GEOM if body == object_body else OTHER_GEOM)
        for owner, body in zip(owners, model.geom_bodyid, strict=True)
    ]
    joints = [model.joint(prefix + joint) for joint in hand.joints]
    return World(
        spec=spec,
        model=model,
        hand=hand,
        object=name,
        protocol=protocol,
        root_at=None if hand.on_arm is not None else int(model.joint(HAND).qposadr[0]),
        object_at=int(model.joint(OBJECT).qposadr[0]),
        joints_at=np.array([joint.qposadr[0] for joint in joints], dtype=int),
        object_body=object_body,
        mass=mass,
        control=moments(model)[:, [joint.dofadr[0] for joint in joints]],
        links=links,
        link_of_geom=np.array(link_of_geom, dtype=int),
    )
