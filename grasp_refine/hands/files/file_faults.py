"""Faults in the file of a hand that cost nothing here, and that other programs take without a word."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from grasp_refine.hands.files.mjcf_xml import is_mjcf
from grasp_refine.hands.files.urdf import controlled_joints, read_urdf
from grasp_refine.hands.files.usd import usd_faults


def file_faults(path: Path) -> tuple[str, ...]:
    """Return the faults in a URDF, an MJCF, or the USD that a URDF was made of, each with its consequence.

    Raises:
        HandError: the file cannot be read.
    """
    found = _mjcf_faults(path) if is_mjcf(path) else {**_urdf_faults(path), **dict.fromkeys(usd_faults(path), [""])}
    return tuple(text.format(", ".join(names)) for text, names in found.items() if names)


def _urdf_faults(path: Path) -> dict[str, list[str]]:
    robot = read_urdf(path)
    joints = {joint.get("name", ""): joint for joint in robot.iterfind("joint")}
    driven = [name for name, one in joints.items() if one.get("type") != "fixed" and one.find("mimic") is None]
    speeds = {name: joints[name].find("limit") for name in driven}
    slow = [name for name, limit in speeds.items() if limit is None or not float(limit.get("velocity") or 0.0) > 0.0]
    lost = [name for name in controlled_joints(path) if name not in joints]
    return {
        "no velocity limit for {}: trajectories are timed by a slow default; set velocity in the URDF": slow,
        "transmissions name {}, which are no joints of the file": lost,
    }


def _mjcf_faults(path: Path) -> dict[str, list[str]]:
    # This loads MuJoCo, which reading a URDF does without.
    import mujoco

    from grasp_refine.hands.files.mjcf import compile_mjcf, read_mjcf

    model = compile_mjcf(read_mjcf(path)[0], path)
    solid = (model.geom_contype | model.geom_conaffinity) != 0
    slippery = solid & ((model.geom_friction[:, 0] <= 0.0) | (model.geom_condim == 1))
    bodies = dict.fromkeys(model.body(body).name for body in model.geom_bodyid[slippery].tolist())
    kinds = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT, mujoco.mjtTrn.mjTRN_TENDON
    moving = np.isin(model.actuator_trntype, list(map(int, kinds)))
    powered = (model.actuator_gaintype != int(mujoco.mjtGain.mjGAIN_FIXED)) | (model.actuator_gainprm[:, 0] != 0.0)
    names = np.array([model.actuator(number).name for number in range(model.nu)], dtype=str)
    idle, powerless = names[~moving].tolist(), names[~powered].tolist()
    return {
        "geoms of {} have no friction: in this file's own contacts they hold nothing": list(bodies),
        "actuators {} move no joint": idle,
        "actuators {} have no gain: their controls do nothing": powerless,
    }
