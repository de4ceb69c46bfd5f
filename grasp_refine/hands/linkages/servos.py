"""Position servos of a MuJoCo model: which actuators are some, joints that they move, stiffness and force limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import mujoco
import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.hands.files.alignment import Mechanism
from grasp_refine.hands.files.defaults import Actuator
from grasp_refine.hands.files.hand_toml import Coupled
from grasp_refine.hands.files.mimics import mimic_map
from grasp_refine.hands.files.mjcf import compile_mjcf, joints_of, read_mjcf


def own_actuator(mechanism: Mechanism, coupled: Sequence[Coupled], fallback: Actuator) -> Actuator:
    """Return the actuators of the MJCF that a hand comes from, in the units and order of `Hand.actuator`.

    Args:
        mechanism: Joints of the hand.
        coupled: Groups of independent joints that share an actuator.
        fallback: Stiffness and limits where the file has no actuators, or others than position servos.
    """
    spec, _, _ = read_mjcf(mechanism.path)
    rescale_servos(spec)
    model = compile_mjcf(spec, mechanism.path)
    matrix, offset, names = mimic_map(mechanism.joints, mechanism.independent)
    matched = {name: name for name in names}
    if not spec.actuators or other_actuators(spec):
        return servos_instead(fallback, mechanism.independent, coupled, model, matched, matrix)
    return servo_settings(mechanism.independent, coupled, model, matched, matrix, offset)


def servos_instead(
    servos: Actuator,
    independent: Sequence[str],
    coupled: Sequence[Coupled],
    model: mujoco.MjModel,
    matched: Mapping[str, str],
    matrix: Float[np.ndarray, "m n"],
) -> Actuator:
    """Return position servos in place of a model's actuators, with the stiffness and limits of `servos`.

    Files with motors often give their joints no damping and no armature, with which servos never come to rest, and
    contacts of light links are soft. So armature is the larger of the joint's own and the servo's, and damping the
    largest of these and the critical one, 2 sqrt(kp I), at the inertia I in the reference configuration, with armature
    and followers. Dry friction is the joint's own.

    Args:
        servos: The servos that replace them.
        independent: The n independent joints.
        coupled: Groups of them that share an actuator.
        model: Model of the hand.
        matched: Joint of the hand -> its name in the model, for m joints.
        matrix: As `HandModel.matrix` (m, n), for these joints.
    """
    dof = [model.joint(name).dofadr[0] for name in matched.values()]
    own = model.jnt_dofadr[[model.joint(matched[name]).id for name in independent]]
    armature = np.maximum(model.dof_armature[own], servos.armature)
    inertia = (matrix**2 * model.dof_M0[dof, None]).sum(axis=0) + armature - model.dof_armature[own]
    critical = 2.0 * np.sqrt(servos.kp * _ratios(independent, coupled) ** 2 * inertia)
    return replace(
        servos,
        damping=np.maximum(np.maximum(model.dof_damping[own], servos.damping), critical),
        armature=armature,
        frictionloss=model.dof_frictionloss[own],
    )


def rescale_servos(spec: mujoco.MjSpec) -> None:
    """Give position servos with other control units, such as 0 to 255, set points in rad or m.

    They press with gain x control - stiffness x length: the control times gain / stiffness is the set point.
    """
    for actuator in spec.actuators:
        gain, stiffness = actuator.gainprm[0], -actuator.biasprm[1]
        if _is_direct(actuator) and gain > 0 and stiffness > 0 and gain != stiffness:
            actuator.ctrlrange = np.asarray(actuator.ctrlrange) * (gain / stiffness)
            gainprm = np.array(actuator.gainprm)
            gainprm[0] = stiffness
            actuator.gainprm = gainprm


def other_actuators(spec: mujoco.MjSpec) -> list[str]:
    """Return names of actuators that are no position servos: their own, or of the joints that they move.

    The force of a servo is the gain times the distance to its set point; a damping of its own is allowed.
    """

    def is_servo(actuator: mujoco.MjsActuator) -> bool:
        return _is_direct(actuator) and bool(actuator.biasprm[1] == -actuator.gainprm[0])

    return [
        actuator.name or actuator.target or f"actuator {number}"
        for number, actuator in enumerate(spec.actuators)
        if not is_servo(actuator)
    ]


def actuator_name(model: mujoco.MjModel, number: int) -> str:
    """Return the name of an actuator, or of the joint or tendon that it moves, or its number."""
    target, transmission = int(model.actuator_trnid[number, 0]), mujoco.mjtTrn(model.actuator_trntype[number])
    moved = ""
    if transmission == mujoco.mjtTrn.mjTRN_TENDON:
        moved = model.tendon(target).name
    elif transmission in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
        moved = model.joint(target).name
    return str(model.actuator(number).name or moved or f"actuator {number}")


def _is_direct(actuator: mujoco.MjsActuator) -> bool:
    """Return True if the force is linear in control, length and speed, without dynamics and constant part."""
    fixed = actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED
    affine = actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE and actuator.biasprm[0] == 0.0
    return bool(fixed and affine and actuator.dyntype == mujoco.mjtDyn.mjDYN_NONE)


def moved_joints(spec: mujoco.MjSpec) -> set[str]:
    """Return names of joints that an actuator moves, directly or through a tendon, or an equality of joints ties."""
    tendon = mujoco.mjtTrn.mjTRN_TENDON
    driven = {actuator.target for actuator in spec.actuators if actuator.trntype == tendon}
    moved = {actuator.target for actuator in spec.actuators if actuator.trntype != tendon}
    for each in spec.tendons:
        if each.name in driven:
            moved |= joints_of(each).keys()
    for equality in spec.equalities:
        if equality.type == mujoco.mjtEq.mjEQ_JOINT:
            moved |= {equality.name1, equality.name2}
    return moved


def moments(model: mujoco.MjModel) -> Float[np.ndarray, "u v"]:
    """Return moment arms (u, v) of actuators about degrees of freedom, constant for joints and tendons."""
    data = mujoco.MjData(model)
    for stage in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_tendon, mujoco.mj_transmission):
        stage(model, data)
    dense = np.zeros((model.nu, model.nv))
    mujoco.mju_sparse2dense(dense, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind)
    return dense


def servo_settings(
    independent: Sequence[str],
    coupled: Sequence[Coupled],
    model: mujoco.MjModel,
    matched: Mapping[str, str],
    matrix: Float[np.ndarray, "m n"],
    offset: Float[np.ndarray, " m"],
) -> Actuator:
    """Return the servos of `model` as actuators of the n independent joints of the hand, in their units and order.

    An actuator whose length changes by M_j with joint j acts on it with kp M_j^2 per error, and with at most |M_j|
    times its own limit; several actuators add up. In a coupled group M_j is divided by the joint's ratio: stiffness and
    limit apply to a tendon whose length is the sum of ratio x joint value, as in `Hand.actuator`. Limits of
    the actuator force at joints and tendons count too. Set points are within the ctrlrange of all actuators of a joint
    or group. Armature and dry friction are the joint's own, and so is damping, to which the damping of the
    servos is added. A joint that nothing drives has the limit 0.

    Args:
        independent: The independent joints.
        coupled: Groups of them that share an actuator.
        model: Model of the hand, all of whose actuators are position servos.
        matched: Joint of the hand -> its name in the model, for m joints.
        matrix: As `HandModel.matrix` (m, n), for these joints.
        offset: As `HandModel.offset` (m,).
    """
    names = list(independent)
    dof = [model.joint(name).dofadr[0] for name in matched.values()]
    arms = moments(model)[:, dof]
    groups = [[names.index(name) for name in group.joints] for group in coupled]
    ratio = _ratios(names, coupled)
    signed = arms @ matrix / ratio
    M, ratio = np.abs(signed), np.abs(ratio)
    # An actuator that does not act on a joint adds nothing to its limit, even if its own limit is infinite.
    reach = np.where(M > 0, _limits(model)[:, None], 0.0) * M
    own = [model.joint(matched[name]).id for name in names]
    limit = np.minimum(
        reach.sum(axis=0),
        _greatest(model.jnt_actfrclimited[own], model.jnt_actfrcrange[own]) / ratio,
    )
    for rows in groups:
        limit[rows] = limit[rows].min()
    own_dof = model.jnt_dofadr[own]
    return Actuator(
        kp=(model.actuator_gainprm[:, :1] * M**2).sum(axis=0),
        force_limit=limit,
        damping=model.dof_damping[own_dof] + (-model.actuator_biasprm[:, 2:3] * M**2).sum(axis=0),
        armature=model.dof_armature[own_dof],
        frictionloss=model.dof_frictionloss[own_dof],
        set_points=_set_points(model, signed, arms @ offset, groups),
    )


def _ratios(names: Sequence[str], coupled: Sequence[Coupled]) -> Float[np.ndarray, " n"]:
    """Return the ratio (n,) of each joint in its coupled group; 1 outside of groups."""
    ratio = {name: 1.0 for name in names}
    for group in coupled:
        ratio.update(zip(group.joints, group.ratio, strict=True))
    return np.array(list(ratio.values()))


def _set_points(
    model: mujoco.MjModel,
    slope: Float[np.ndarray, "u n"],
    offset: Float[np.ndarray, " u"],
    groups: Sequence[Sequence[int]],
) -> Float[np.ndarray, "n 2"] | None:
    """Return the range (n, 2) of set points within every ctrlrange; None where there is none.

    Args:
        model: Model of the hand.
        slope: Control (u, n) of each actuator per set point of each joint or, of a group, of its tendon.
        offset: Control (u,) of each actuator where all set points are 0.
        groups: Indices of the joints of each group.
    """
    if not model.actuator_ctrllimited.any():
        return None
    first = np.arange(slope.shape[1])
    for rows in groups:
        first[rows] = rows[0]
    ends = np.tile([-np.inf, np.inf], (slope.shape[1], 1))
    for actuator in np.flatnonzero(model.actuator_ctrllimited):
        driven = np.flatnonzero(slope[actuator])
        # Where an actuator drives several set points, the range of each depends on the others: it is not known.
        if len({*first[driven]}) == 1:
            low, high = np.sort((model.actuator_ctrlrange[actuator] - offset[actuator]) / slope[actuator, driven[0]])
            same = first == first[driven[0]]
            ends[same, 0] = np.maximum(ends[same, 0], low)
            ends[same, 1] = np.minimum(ends[same, 1], high)
    return ends


def _limits(model: mujoco.MjModel) -> Float[np.ndarray, " u"]:
    """Return the force limit (u,) of each actuator, with that of its tendon."""
    limits = _greatest(model.actuator_forcelimited, model.actuator_forcerange)
    at = np.flatnonzero(model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON)
    tendons = model.actuator_trnid[at, 0]
    limits[at] = np.minimum(
        limits[at], _greatest(model.tendon_actfrclimited[tendons], model.tendon_actfrcrange[tendons])
    )
    return limits


def _greatest(limited: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return the larger absolute end (k,) of ranges (k, 2); inf where there is no limit."""
    return np.where(limited.astype(bool), np.abs(reach).max(axis=1), np.inf)
