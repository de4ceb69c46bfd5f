"""Compliance of linkages: how far fingertips give way in simulation while the driven joint stands still.

Equalities and limits of joints are soft in MuJoCo, the softer the lighter the bodies are that they hold. In a linkage
they are springs between the actuator and the fingertips, in series with its stiffness.
"""

from __future__ import annotations

import copy
from collections.abc import Collection
from dataclasses import dataclass

import mujoco
import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.se3 import log_so3
from grasp_refine.hands.linkages.linkages import AT_LIMIT, Linkage
from grasp_refine.hands.linkages.yielding import YieldingMode

LOAD_N = 15.0
"""Force in newtons on each fingertip: that of a squeeze."""

LOADED_S, TIMESTEP_S = 1.0, 0.004
"""Duration in seconds of the simulation, and of its steps, as in our protocols: no constraint of MuJoCo is
stiffer than two steps allow."""

STANDING_ARMATURE = 1e6
"""Inertia, in kg m^2 or kg, with which the driven joint stands still."""

STEP = 1e-4
"""Change of the driven joint, in rad or m, over which velocities of fingertips are found."""


@dataclass(frozen=True, eq=False)
class _Load:
    """Wrench that a fingertip exerts on an object, and how its body moves as the linkage closes."""

    body: int
    wrench: Float[np.ndarray, " 6"]
    """Force and moment about the centre of mass."""
    rate: Float[np.ndarray, " 6"]
    """Velocity of the centre of mass and angular velocity per unit of the driven joint."""


def transmission_compliance(model: mujoco.MjModel, linkage: Linkage, tips: Collection[str]) -> float:
    """Return the compliance of a linkage as seen at its driven joint, in rad per N m or m per N.

    Each fingertip is pressed back at the middle of the range, where the load moves no mode of the linkage. It is the
    work of the loads over the square of the torque at the driven joint that would balance them.

    Args:
        model: Model of the linkage.
        linkage: The linkage.
        tips: Names of the bodies that touch objects; bodies that the linkage does not move are left out.
    """
    model = copy.copy(model)
    flags = mujoco.mjtDisableBit
    model.opt.disableflags |= flags.mjDSBL_CONTACT | flags.mjDSBL_GRAVITY | flags.mjDSBL_ACTUATION
    model.opt.timestep = TIMESTEP_S
    data = mujoco.MjData(model)
    loads = _loads(model, data, linkage, tips)
    for name in (linkage.driver, *(_stop(model, data, linkage, mode) for mode in linkage.modes)):
        model.dof_armature[model.joint(name).dofadr] = STANDING_ARMATURE
    if not loads:
        return 0.0
    start = data.xipos.copy(), data.ximat.copy()
    for load in loads:
        data.xfrc_applied[load.body] = -load.wrench
    mujoco.mj_step(model, data, nstep=int(LOADED_S / model.opt.timestep))
    work = 0.0
    for load in loads:
        turned = data.ximat[load.body].reshape(3, 3) @ start[1][load.body].reshape(3, 3).T
        work -= load.wrench @ np.concatenate([data.xipos[load.body] - start[0][load.body], log_so3(turned)])
    torque = sum(load.wrench @ load.rate for load in loads)
    return max(float(work / torque**2), 0.0)


def _stop(model: mujoco.MjModel, data: mujoco.MjData, linkage: Linkage, mode: YieldingMode) -> str:
    """Name of the joint at whose limit a mode rests; its own joint where there is none."""
    for name in linkage.coefficients:
        joint = model.joint(name)
        at_limit = np.abs(joint.range - data.qpos[joint.qposadr]).min() < AT_LIMIT
        if model.jnt_limited[joint.id] and at_limit and model.body(model.jnt_bodyid[joint.id]).name in mode.twists:
            return str(name)
    return mode.joint


def _loads(model: mujoco.MjModel, data: mujoco.MjData, linkage: Linkage, tips: Collection[str]) -> list[_Load]:
    """Loads of the fingertips at the middle of the range, to which `data` is set."""
    middle = 0.5 * sum(linkage.range)
    poses = []
    for value in (middle - STEP, middle + STEP, middle):
        linkage.place(model, data, value)
        poses.append((data.xipos.copy(), data.ximat.reshape(-1, 3, 3).copy()))
    (p0, R0), (p1, R1), (p, _) = poses
    bodies = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in tips]
    rates = {
        body: np.concatenate([p1[body] - p0[body], log_so3(R1[body] @ R0[body].T)]) / (2.0 * STEP)
        for body in bodies
        if body > 0
    }
    rates = {body: rate for body, rate in rates.items() if np.linalg.norm(rate[:3]) > 0.0}
    if not rates:
        return []
    center = np.mean([p[body] for body in rates], axis=0)
    closing = np.sign(sum(rate[:3] @ (center - p[body]) for body, rate in rates.items())) or 1.0
    loads = []
    for body, rate in rates.items():
        force = LOAD_N * closing * rate[:3] / np.linalg.norm(rate[:3])
        modes = [mode for mode in linkage.modes if model.body(body).name in mode.twists]
        twists = np.array(
            [_at_center(data, body, mode.twist(model.body(body).name, np.array([middle]))[0]) for mode in modes]
        )
        moment = np.zeros(3)
        if len(twists):
            moment = np.linalg.lstsq(twists[:, 3:], -twists[:, :3] @ force, rcond=None)[0]
        loads.append(_Load(body, np.concatenate([force, moment]), rate))
    return loads


def _at_center(data: mujoco.MjData, body: int, twist: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " 6"]:
    """Velocity of a body's centre of mass and its angular velocity, in the world, of its twist in its own frame."""
    linear, angular = (data.xmat[body].reshape(3, 3) @ part for part in np.split(twist, 2))
    return np.concatenate([linear + np.cross(angular, data.xipos[body] - data.xpos[body]), angular])
