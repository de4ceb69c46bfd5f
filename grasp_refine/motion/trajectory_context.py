"""Context of trajectories in their files: joints with their followers and actuators, and surroundings of the hand."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.json_files import dumps
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.hands.files.mimics import followed
from grasp_refine.hands.hand import Hand
from grasp_refine.motion.trajectory import PERIOD_S, speed_limits
from grasp_refine.scene.scene import Scene

CONVENTIONS = {
    "units": "metres, radians, seconds, kilograms, newtons, newton metres; joints that slide have metres and newtons",
    "pose": "x y z qw qx qy qz: origin, and rotation as a unit quaternion with its scalar first, of a frame in another",
    "object_frame": "frame of the object's mesh, where the object is before the lift; poses are in it where no other "
    "frame is named",
    "base_pose": "pose of base_link in the object's frame; of a hand on an arm it is the base of the arm, and constant",
    "palm_pose": "pose of the link named palm in the object's frame; palm_pose_base: in the frame of base_link",
    "q": "set points of position servos, one column for each of joint_names; joints that follow others are among them",
    "time": f"seconds from 0 on, {PERIOD_S:g} s apart; waypoints are at the set points of their index",
    "interpolation": "between two set points linear in q and in origins, rotations along the shortest arc",
    "velocity": "rates of q by central differences, per second; 0 at the waypoints, where the hand rests",
    "squeeze": "fingers press as their set points, in the legs squeeze and lift, lie beyond where the object stops "
    "them: torque = kp x (q at squeeze - q at grasp), at most force_limit",
    "mimic": "value of a joint that follows = c0 + c1 x + c2 x^2 + ..., with x that of the joint that it follows",
}
"""Meaning of the numbers, by key."""


def all_values(hand: Hand, q: Float[np.ndarray, "*K n"]) -> Float[np.ndarray, "*K m"]:
    """Return the values (..., m) of all movable joints, in the order of `joint_entries`."""
    matrix, offset, _ = hand.mimic_map()
    return q @ matrix.T + offset + hand.curves(q)


def pressing_torques(hand: Hand, q: Float[np.ndarray, "2 n"]) -> Float[np.ndarray, " m"]:
    """Return the torques (m,) with which joints press that are held at the first values; 0 for followers.

    Args:
        hand: The hand.
        q: Values (2, n) at the grasp, and at the squeeze.
    """
    driven = hand.actuator
    torque = np.clip(driven.kp * (q[1] - q[0]), -driven.force_limit, driven.force_limit)
    by_name = dict(zip(hand.joint_names, np.where(hand.arm_joints, 0.0, torque).tolist(), strict=True))
    return np.array([by_name.get(joint.name, 0.0) for joint in hand.joints if joint.movable])


def joint_entries(hand: Hand) -> list[dict[str, Any]]:
    """Return an entry for each movable joint: its kind and limits, the joint that it follows, or its servo."""
    speeds = dict(zip(hand.joint_names, speed_limits(hand).tolist(), strict=True))
    place = {name: number for number, name in enumerate(hand.joint_names)}
    entries = []
    for joint in hand.joints:
        if not joint.movable:
            continue
        leads = followed(joint, hand.joints_by_name)
        at = place[leads.joint]
        servo = {key: float(getattr(hand.actuator, key)[at]) for key in ("kp", "damping", "force_limit", "armature")}
        entries.append(
            {
                "name": joint.name,
                "kind": joint.kind,
                "arm": bool(hand.arm_joints[at]),
                "lower": joint.lower,
                "upper": joint.upper,
                "speed_limit": None if joint.mimic else speeds[joint.name],
                "mimic": {"joint": leads.joint, "coefficients": list(leads.coefficients)} if joint.mimic else None,
                "servo": None if joint.mimic else servo,
            }
        )
    return entries


def robot_entry(hand: Hand) -> dict[str, Any]:
    """Return the files of a hand, and of its arm, and the pose in which it is mounted."""
    if not hand.parts:
        return {"files": [hand.urdf], "mount": None}
    joint = next(joint for joint in hand.joints if joint.child == hand.palm)
    mounted = {"parent": joint.parent, "child": joint.child, "pose": pose_from_transform(joint.T_parent_child)}
    return {"files": [part.urdf for part in hand.parts], "mount": mounted}


def scene_entry(scene: Scene, scale: float) -> dict[str, Any]:
    """Return the object of a scene with its mesh, the table, and the bodies around it with their poses.

    Args:
        scene: The scene.
        scale: Factor that takes the object's mesh to metres.
    """
    obj, around, table = scene.object, scene.environment, scene.table
    file, factor = obj.file or (None, scale)
    return {
        "object": {
            "name": obj.name,
            "scale": scale,
            "mesh": file,
            "mesh_to_metres": factor,
            "bounds": obj.mesh.bounds,
        },
        "table": None if table is None else {"normal": table.normal, "offset": table.offset},
        "scene": None
        if around is None
        else {
            "name": around.name,
            "source": around.source,
            "object_pose_world": pose_from_transform(around.T_world_object),
            "bodies": [
                {
                    "name": body.name,
                    "pose": pose_from_transform(T),
                    "pose_world": pose_from_transform(body.T_world_body),
                    "movable": body.movable,
                    "mass": body.mass,
                }
                for body, T in zip(around.bodies, around.T_object_body, strict=True)
            ],
        },
    }


def joint_arrays(entries: Sequence[dict[str, Any]]) -> dict[str, np.ndarray]:
    """Return the entries of joints as arrays (m,) of an .npz file; NaN where there is none, and one text for mimics."""
    servos = [entry["servo"] or {} for entry in entries]
    return {
        "joint_names": np.array([entry["name"] for entry in entries]),
        "joint_kind": np.array([entry["kind"] for entry in entries]),
        "arm_joint": np.array([entry["arm"] for entry in entries], dtype=bool),
        "lower": np.array([entry["lower"] for entry in entries]),
        "upper": np.array([entry["upper"] for entry in entries]),
        "speed_limit": np.array([np.nan if (v := entry["speed_limit"]) is None else v for entry in entries]),
        **{key: np.array([servo.get(key, np.nan) for servo in servos]) for key in ("kp", "damping", "force_limit")},
        "mimic": as_text([entry["mimic"] for entry in entries]),
    }


def as_text(document: Any) -> np.ndarray:
    """Return a document as the JSON text of an .npz file."""
    return np.array(json.dumps(json.loads(dumps(document))))
