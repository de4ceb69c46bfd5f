"""Model of a hand for MuJoCo, read from an MJCF file and matched to the hand's joints by name and position."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np

from grasp_refine.core.plurals import count_text
from grasp_refine.hands.files.alignment import Mechanism, align, body_pose
from grasp_refine.hands.files.mjcf import compile_mjcf, delete, joints_of, matched_joints, read_mjcf
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.linkages.linkages import linkages
from grasp_refine.hands.linkages.servos import (
    moved_joints,
    other_actuators,
    rescale_servos,
    servo_settings,
    servos_instead,
)
from grasp_refine.hands.linkages.tendon_ties import tendon_ties
from grasp_refine.validation.engines.mujoco.hand_model import HandModel
from grasp_refine.validation.engines.mujoco.urdf_model import add_actuators

SIZE_FIELDS = ("memory", "nstack", "njmax", "nconmax", "nemax", "nkey", "nuserdata")
"""Fields of <size>, except user data of bodies, joints and so on (`nuser_*`)."""


def mjcf_model(hand: Hand, path: Path) -> HandModel:
    """Return the hand in the MJCF file `path`, which must move as `hand` does.

    Collision geometry, contact parameters, dampings, limits and position actuators come from the file. Removed are
    visual geometry (its mass stays), cameras, lights, keyframes, sensors, a free joint at the root, and everything in
    the world beside the hand. Joints that `hand` lacks are fixed at their reference positions.

    Names are matched first (`hand.mjcf_joints`, equal names, then up to a prefix); then `align` finds base pose and
    signs, and checks them.

    Raises:
        HandError: the file cannot be used, or is of another hand.
    """
    spec, root, notes = read_mjcf(path)
    _reset(spec)
    rescale_servos(spec)
    mechanism = Mechanism(hand.name, hand.urdf, hand.base_link, hand.joints, hand.joint_names)
    matched = matched_joints(mechanism, hand.mjcf_joints, spec, path)
    _drop_joints(spec, set(matched.values()), notes)
    _drop_visuals(spec, path)
    matrix, offset, movable = hand.mimic_map()
    rows = [movable.index(name) for name in matched]
    model = compile_mjcf(spec, path)
    fit = align(mechanism, matched, model, path)
    notes += fit.notes
    driven = {joint: matched[joint] for joint in hand.joint_names}
    others = other_actuators(spec)
    if others or not spec.actuators:
        delete(spec, list(spec.actuators))
        add_actuators(spec, hand, driven, dict(zip(matched, fit.sign, strict=True)))
        servos = servos_instead(hand.actuator, hand.joint_names, hand.coupled, model, matched, matrix[rows])
        for name, damping, armature in zip(driven.values(), servos.damping, servos.armature, strict=True):
            joint = spec.joint(name)
            joint.damping, joint.armature = [damping, *np.ravel(joint.damping)[1:]], armature
        why = f"actuators that are no position servos ({', '.join(others)})" if others else "no actuators"
        used = count_text(len(spec.actuators), "position actuator")
        notes.append(f"{path.name} has {why}: {used} of its joints take their place, as for a URDF")
    T_base_root = fit.T_base_world @ body_pose(model, root)
    # The pose of the hand in its file has no meaning in another world.
    top = spec.body(root)
    top.pos, top.quat, top.alt.type = np.zeros(3), [1, 0, 0, 0], mujoco.mjtOrientation.mjORIENTATION_QUAT
    placed = compile_mjcf(spec, path)
    moved = moved_joints(spec)
    moved |= {tie.follower for tie in tendon_ties(spec, placed, moved)}
    chained = {name for linkage in linkages(placed, moved).linkages for name in linkage.coefficients}
    idle = [joint for joint, name in matched.items() if name not in moved | chained]
    if idle:
        notes.append(f"joints {', '.join(idle)} follow nothing in {path.name}: no actuator, equality or tendon")
    if placed.actuator_ctrllimited.any():
        notes.append("set points beyond the ctrlrange of the MJCF are clipped")
    matrix, offset = fit.sign[:, None] * matrix[rows], fit.sign * offset[rows]
    return HandModel(
        spec=spec,
        root=root,
        T_base_root=T_base_root,
        joints=tuple(matched.values()),
        matrix=matrix,
        offset=offset,
        links=_links(hand, model, root, matched, own=path.samefile(hand.urdf)),
        notes=tuple(notes),
        actuator=servo_settings(hand.joint_names, hand.coupled, placed, matched, matrix, offset),
        curves=hand.curves.take(rows, fit.sign),
        patches=hand.patches,
    )


def _reset(spec: mujoco.MjSpec) -> None:
    """Reset the options of simulation and display, and the sizes, to the defaults of MuJoCo.

    These belong to the world, not to the hand; MuJoCo warns where they differ from the world's.
    """
    plain = mujoco.MjSpec()
    visual = [(getattr(spec.visual, name), getattr(plain.visual, name)) for name in _public(plain.visual)]
    for ours, default in ((spec.option, plain.option), (spec.stat, plain.stat), *visual):
        for name in _public(default):
            setattr(ours, name, getattr(default, name))
    for name in _public(plain):
        if name in SIZE_FIELDS or name.startswith("nuser_"):
            setattr(spec, name, getattr(plain, name))
    for name in _public(spec.authored):
        setattr(spec.authored, name, 0)


def _public(thing: object) -> list[str]:
    return [name for name in dir(thing) if not name.startswith("_")]


def _drop_joints(spec: mujoco.MjSpec, kept: set[str], notes: list[str]) -> None:
    """Delete joints that are not kept, and what acts on them."""
    dropped = {joint.name for joint in spec.joints} - kept
    if not dropped:
        return
    listed = [joint.name for joint in spec.joints if joint.name in dropped]
    notes.append(f"joints {', '.join(listed)} of the MJCF are fixed: the hand does not have them")
    loose = {tendon.name for tendon in spec.tendons if joints_of(tendon).keys() & dropped}
    joint_like = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)

    def acts(actuator: mujoco.MjsActuator) -> bool:
        if actuator.trntype in joint_like:
            return actuator.target in dropped
        return actuator.trntype == mujoco.mjtTrn.mjTRN_TENDON and actuator.target in loose

    def ties(equality: mujoco.MjsEquality) -> bool:
        names = {equality.name1, equality.name2}
        if equality.type == mujoco.mjtEq.mjEQ_JOINT:
            return bool(names & dropped)
        return equality.type == mujoco.mjtEq.mjEQ_TENDON and bool(names & loose)

    delete(spec, [actuator for actuator in spec.actuators if acts(actuator)])
    delete(spec, [equality for equality in spec.equalities if ties(equality)])
    delete(spec, [tendon for tendon in spec.tendons if tendon.name in loose])
    delete(spec, [joint for joint in spec.joints if joint.name in dropped])


def _drop_visuals(spec: mujoco.MjSpec, path: Path) -> None:
    """Delete visual geometry, after writing its mass into its body."""
    model = compile_mjcf(spec, path)
    for body in spec.bodies[1:]:
        compiled = model.body(body.name)
        body.mass, body.ipos, body.iquat = compiled.mass[0], compiled.ipos, compiled.iquat
        body.inertia, body.explicitinertial = compiled.inertia, True
        # These take precedence over the moments, where they are given.
        body.fullinertia = [np.nan, *[0.0] * 5]
        body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    spec.compiler.settotalmass = -1.0
    spec.discard_visual()


def _links(hand: Hand, model: mujoco.MjModel, root: str, matched: Mapping[str, str], *, own: bool) -> dict[str, str]:
    """Return body -> link that it represents: the child of a matched joint, the base link, or itself."""
    names = [model.body(number).name for number in range(1, model.nbody)]
    links = {name: name for name in names}
    if own:
        return links
    jointed = [model.body(int(model.joint(name).bodyid[0])) for name in matched.values()]
    for name, body in zip(matched, jointed, strict=True):
        links[body.name] = hand.joints_by_name[name].child
    # A mount or a forearm may come before the palm, at which the hand begins; they are one rigid part.
    part = model.body_weldid == model.body(root).weldid
    parents = [model.body(int(body.parentid[0])).name for body in jointed if part[body.parentid[0]]]
    base = max([root, *parents], key=lambda name: (parents.count(name), name == root))
    links[base] = hand.base_link
    return links
