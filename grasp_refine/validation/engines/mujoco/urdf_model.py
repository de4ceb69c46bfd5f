"""Model of a hand for MuJoCo, made from the links, joints and convex pieces that are refined.

MuJoCo's own URDF reader is not used: mesh paths, fixed joints, mimic joints and impossible inertias are its traps, and
the simulated hand would not be the refined one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import mujoco
import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.plurals import names_text
from grasp_refine.core.se3 import quaternion_from_matrix
from grasp_refine.hands.files.inertia import DENSITY, Inertia
from grasp_refine.hands.files.mimics import Curves
from grasp_refine.hands.files.tree import rigid_parts
from grasp_refine.hands.hand import Hand, Link
from grasp_refine.hands.self_collision import touching_pairs
from grasp_refine.validation.engines.mujoco.geoms import add_piece
from grasp_refine.validation.engines.mujoco.hand_model import HandModel

STEEL_DENSITY_KG_M3 = 7850.0
"""Density of steel in kg/m^3, above which a note is returned."""

MAX_GYRATION_SHARE = 2.0
"""Largest radius of gyration of a link as a share of its reach from the centre of mass; parts that do not collide may
reach farther."""

DEFAULT_INERTIA = Inertia(1e-3, np.zeros(3), 1e-6 * np.eye(3))
"""Inertia of a moving part without mass and geometry in the URDF: 1 g."""

MIMIC_SOLVER_PARAMETERS = {"solref": [0.01, 1.0], "solimp": [0.999, 0.9999, 1e-3, 0.5, 2.0]}
"""Solver parameters of mimic joints: as stiff as steps of 4 ms allow."""


@dataclass(frozen=True, eq=False)
class Parts:
    """Rigid parts of a hand: groups of links that move together."""

    matrix: Float[np.ndarray, "m n"]
    """Matrix (m, n): values of the m joints that can move are `matrix` times q, plus `offset`."""
    offset: Float[np.ndarray, " m"]
    """Offset (m,) of the joint values, in rad or m."""
    curves: Curves
    """Parts of the joint values that are not linear."""
    joints: tuple[str, ...]
    """Names of the m joints that can move."""
    still: Mapping[str, float]
    """Values in rad or m of the movable joints that cannot move: equal limits, and mimics of such joints."""
    of: Mapping[str, str]
    """Link -> first link of its part, which is the child of a joint, or the base link."""
    carrier: Mapping[str, str]
    """First link of a part -> that of its parent part."""

    @classmethod
    def by_joints(cls, hand: Hand) -> Parts:
        """Return the parts of `hand`."""
        matrix, offset, names = hand.mimic_map()
        free = hand.lower < hand.upper
        curved = hand.curves.curved & free[hand.curves.leader]
        moves = (matrix[:, free] != 0).any(axis=1) | curved
        fixed = np.where(free, 0.0, hand.lower)
        at = matrix @ fixed + offset + hand.curves(fixed)
        still = {name: float(value) for name, value in zip(names, at, strict=True) if not moves[names.index(name)]}
        joints = tuple(name for name, moving in zip(names, moves, strict=True) if moving)
        of = {hand.base_link: hand.base_link} | rigid_parts(hand.joints, joints)
        carrier = {joint.child: of[joint.parent] for joint in hand.joints if joint.name in joints}
        return cls(matrix[moves], offset[moves], hand.curves.take(np.flatnonzero(moves)), joints, still, of, carrier)


def urdf_model(hand: Hand) -> HandModel:
    """Return the model of `hand` for MuJoCo: a body for each link, its convex pieces, and position actuators.

    Joints have the limits of the URDF, and damping, armature and dry friction of `hand.actuator`; mimic joints have no
    limits and follow by equality constraints. Hand links collide with each other only in pairs of `touching_pairs`,
    and with everything else. A locked joint (equal limits) is no joint here.
    """
    spec = mujoco.MjSpec()
    spec.modelname = hand.name
    spec.compiler.degree, spec.compiler.fusestatic = False, False
    parts = Parts.by_joints(hand)
    names = _body_names(hand)
    bodies = {hand.base_link: spec.worldbody.add_body(name=names[hand.base_link])}
    for joint in hand.joints:
        T = joint.T_parent_child
        if joint.name in parts.still:
            T = T @ joint.motion(np.array(parts.still[joint.name]))
        bodies[joint.child] = bodies[joint.parent].add_body(
            name=names[joint.child], pos=T[:3, 3], quat=quaternion_from_matrix(T[:3, :3])
        )
        if joint.name in parts.joints:
            _add_joint(spec, bodies[joint.child], hand, parts, parts.joints.index(joint.name))
    rounded = [link.name for link in hand.links if link.body is not None and _add_geoms(spec, bodies[link.name], link)]
    notes = _add_masses(hand, parts, bodies)
    if rounded:
        notes.append(f"rounded edges of {', '.join(rounded)} are polyhedra in the simulation")
    add_actuators(spec, hand, {name: name for name in hand.joint_names if name in parts.joints})
    for a, b in excluded_pairs(hand, parts):
        spec.add_exclude(bodyname1=names[a], bodyname2=names[b])
    return HandModel(
        spec=spec,
        root=names[hand.base_link],
        T_base_root=np.eye(4),
        joints=parts.joints,
        matrix=parts.matrix,
        offset=parts.offset,
        links={body: link for link, body in names.items()},
        notes=tuple(notes),
        actuator=hand.actuator,
        curves=parts.curves,
        patches=hand.patches,
        on_arm=None if hand.arm is None else hand,
    )


def add_actuators(
    spec: mujoco.MjSpec, hand: Hand, joints: Mapping[str, str], sign: Mapping[str, float] | None = None
) -> None:
    """Add position actuators of `hand` to `spec`, named like their joints: one per joint, one per coupled group.

    A group acts on a tendon whose length is the sum of ratio x joint value; stiffness and force limit come from
    its first joint.

    Args:
        spec: Specification with the joints, to which actuators are added.
        hand: The hand.
        joints: Independent joint of the hand -> name in `spec`; others are left out.
        sign: Independent joint -> -1 where its values have the other sign in `spec`.
    """
    row = {name: i for i, name in enumerate(hand.joint_names)}

    def add(name: str, target: str, kind: mujoco.mjtTrn, i: int) -> None:
        kp, limit = hand.actuator.kp[i], hand.actuator.force_limit[i]
        # MuJoCo refuses an empty range: an actuator with a limit of 0 gets no stiffness.
        servo = spec.add_actuator(name=name, target=target, trntype=kind)
        servo.set_to_position(kp=kp if limit > 0 else 0.0)
        if 0 < limit < np.inf:
            servo.forcelimited, servo.forcerange = True, [-limit, limit]

    grouped = {joint for group in hand.coupled for joint in group.joints}
    for joint, name in joints.items():
        if joint not in grouped:
            add(name, name, mujoco.mjtTrn.mjTRN_JOINT, row[joint])
    for group in hand.coupled:
        driven = [(joint, ratio) for joint, ratio in zip(group.joints, group.ratio, strict=True) if joint in joints]
        if driven:
            tendon = spec.add_tendon(name="+".join(joints[joint] for joint, _ in driven))
            for joint, ratio in driven:
                tendon.wrap_joint(joints[joint], ratio * (sign or {}).get(joint, 1.0))
            add(tendon.name, tendon.name, mujoco.mjtTrn.mjTRN_TENDON, row[driven[0][0]])


def excluded_pairs(hand: Hand, parts: Parts) -> list[tuple[str, str]]:
    """Return the pairs of links that must not collide, without neighbours, which MuJoCo never lets collide."""
    touching = {frozenset(pair) for pair in touching_pairs(hand)}
    solid = [link.name for link in hand.links if link.body is not None]
    return [
        (a, b)
        for a, b in combinations(solid, 2)
        if frozenset((a, b)) not in touching
        and parts.of[a] != parts.of[b]
        and parts.carrier.get(parts.of[a]) != parts.of[b]
        and parts.carrier.get(parts.of[b]) != parts.of[a]
    ]


def _body_names(hand: Hand) -> dict[str, str]:
    """Return link -> body; MuJoCo's own root has the name "world", which is also common in URDFs."""
    taken = {link.name for link in hand.links}
    other = "world_link"
    while other in taken:
        other += "_"
    return {name: other if name == "world" else name for name in (link.name for link in hand.links)}


def _add_joint(spec: mujoco.MjSpec, body: mujoco.MjsBody, hand: Hand, parts: Parts, index: int) -> None:
    joint = hand.joints_by_name[parts.joints[index]]
    row = parts.matrix[index]
    leader = int(np.abs(row).argmax())
    slides = joint.kind == "prismatic"
    added = body.add_joint(
        name=joint.name,
        type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE,
        axis=joint.axis,
        damping=hand.actuator.damping[leader],
        armature=hand.actuator.armature[leader],
    )
    if joint.mimic is not None:
        tie = spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            name1=joint.name,
            name2=hand.joint_names[leader],
            **MIMIC_SOLVER_PARAMETERS,
        )
        # A polynomial, whose number of coefficients differs between versions of MuJoCo.
        data = [parts.offset[index], row[leader], *parts.curves.higher[index].tolist()]
        tie.data = [*data, *[0.0] * (len(tie.data) - len(data))]
        return
    added.frictionloss = hand.actuator.frictionloss[leader]
    if joint.kind != "continuous":
        added.limited, added.range = True, [joint.lower, joint.upper]


def _add_geoms(spec: mujoco.MjSpec, body: mujoco.MjsBody, link: Link) -> bool:
    """Add the pieces of `link` to its body; return True if a rounded piece had to become a polyhedron."""
    for number, piece in enumerate(link.solid.pieces):
        # Masses are explicit; the other methods of inertias refuse thin or small meshes.
        add_piece(spec, body, piece, f"{body.name}:{number}", inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    return any(piece.radius > 0 and len(piece.vertices) > 2 for piece in link.solid.pieces)


def _add_masses(hand: Hand, parts: Parts, bodies: Mapping[str, mujoco.MjsBody]) -> list[str]:
    """Set mass and inertia of the bodies; return notes on repairs."""
    kinds: dict[str, list[str]] = {
        f"mass and inertia of solid pieces of {DENSITY:g} kg/m^3, as the URDF gives no mass: {{}}": [],
        "inertia from mass and geometry, or of a sphere of 1 cm, as the URDF gives none above 0: {}": [],
        "inertia from mass and geometry, as that of the URDF needs matter far outside of the link: {}": [],
        "inertia balanced, as its principal moments broke the triangle inequality: {}": [],
        "denser than steel by the mass in the URDF, which slows the simulated hand: {}": [],
        f"{DEFAULT_INERTIA.mass * 1e3:g} g assumed, as the URDF gives neither mass nor geometry: {{}}": [],
    }
    without_mass, without_moments, too_wide, unbalanced, too_dense, without_all = kinds.values()
    weighed = set()
    for link in hand.links:
        inertia = link.inertia
        mass = link.mass or 0.0
        if link.body is not None and mass > STEEL_DENSITY_KG_M3 / DENSITY * Inertia.of(link.body.pieces).mass:
            too_dense.append(link.name)
        if inertia is not None and inertia.positive():
            if link.body is not None and inertia.gyration_radius() > MAX_GYRATION_SHARE * _reach(link, inertia.centre):
                too_wide.append(link.name)
                inertia = _inertia_of_mass(link, mass)
            elif not inertia.possible():
                unbalanced.append(link.name)
        elif mass > 0:
            without_moments.append(link.name)
            inertia = _inertia_of_mass(link, mass)
        elif link.body is not None:
            without_mass.append(link.name)
            inertia = Inertia.of(link.body.pieces)
        else:
            continue
        weighed.add(parts.of[link.name])
        _set_inertia(bodies[link.name], inertia.balanced())
    for first in dict.fromkeys(parts.of.values()):
        if first not in weighed:
            without_all.append(first)
            _set_inertia(bodies[first], DEFAULT_INERTIA)
    return [note.format(names_text(links)) for note, links in kinds.items() if links]


def _reach(link: Link, centre: Float[np.ndarray, " 3"]) -> float:
    """Return the distance in metres of the farthest point of a link's geometry from `centre`."""
    return max(
        float(np.linalg.norm(piece.vertices - centre, axis=1).max()) + piece.radius for piece in link.solid.pieces
    )


def _inertia_of_mass(link: Link, mass: float) -> Inertia:
    """Return the inertia of `link` with the given mass, distributed like its geometry, or like a sphere of 1 cm."""
    centre = None if link.inertia is None else link.inertia.centre
    if link.body is None:
        return Inertia(mass, np.zeros(3) if centre is None else centre, 0.4 * mass * 0.01**2 * np.eye(3))
    solid = Inertia.of(link.body.pieces)
    return Inertia(mass, solid.centre if centre is None else centre, solid.matrix * (mass / solid.mass))


def _set_inertia(body: mujoco.MjsBody, inertia: Inertia) -> None:
    moments, axes = inertia.principal()
    body.mass, body.ipos, body.iquat, body.inertia = inertia.mass, inertia.centre, quaternion_from_matrix(axes), moments
    body.explicitinertial = True
