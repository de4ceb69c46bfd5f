"""Messages of ROS 2 as bytes: CDR, little endian, as its middlewares send and bags store them.

Each number is aligned to its size, counted from the end of the encapsulation header; a string is its length with the
closing zero, and its bytes; a sequence is its length, and its elements.

Source: OMG, DDS-XTypes 1.3, section 7.4.1 (encoding XCDR1); the messages are those of moveit/moveit_msgs,
ros2/common_interfaces and ros2/rcl_interfaces.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

HEADER = b"\x00\x01\x00\x00"
"""Encapsulation header: plain CDR, little endian, no options."""

NUMBERS = {"int32": "i", "uint32": "I", "float32": "f", "float64": "d"}
"""Type of a number -> its code in `struct`."""

_HEADER = ("header", "std_msgs/msg/Header")

MESSAGES: dict[str, tuple[tuple[str, str], ...]] = {
    "builtin_interfaces/msg/Time": (("sec", "int32"), ("nanosec", "uint32")),
    "builtin_interfaces/msg/Duration": (("sec", "int32"), ("nanosec", "uint32")),
    "std_msgs/msg/Header": (("stamp", "builtin_interfaces/msg/Time"), ("frame_id", "string")),
    "geometry_msgs/msg/Point": (("x", "float64"), ("y", "float64"), ("z", "float64")),
    "geometry_msgs/msg/Vector3": (("x", "float64"), ("y", "float64"), ("z", "float64")),
    "geometry_msgs/msg/Quaternion": (("x", "float64"), ("y", "float64"), ("z", "float64"), ("w", "float64")),
    "geometry_msgs/msg/Pose": (
        ("position", "geometry_msgs/msg/Point"),
        ("orientation", "geometry_msgs/msg/Quaternion"),
    ),
    "geometry_msgs/msg/PoseStamped": (_HEADER, ("pose", "geometry_msgs/msg/Pose")),
    "geometry_msgs/msg/Vector3Stamped": (_HEADER, ("vector", "geometry_msgs/msg/Vector3")),
    "trajectory_msgs/msg/JointTrajectoryPoint": (
        ("positions", "float64[]"),
        ("velocities", "float64[]"),
        ("accelerations", "float64[]"),
        ("effort", "float64[]"),
        ("time_from_start", "builtin_interfaces/msg/Duration"),
    ),
    "trajectory_msgs/msg/JointTrajectory": (
        _HEADER,
        ("joint_names", "string[]"),
        ("points", "trajectory_msgs/msg/JointTrajectoryPoint[]"),
    ),
    "geometry_msgs/msg/Transform": (
        ("translation", "geometry_msgs/msg/Vector3"),
        ("rotation", "geometry_msgs/msg/Quaternion"),
    ),
    "geometry_msgs/msg/Twist": (("linear", "geometry_msgs/msg/Vector3"), ("angular", "geometry_msgs/msg/Vector3")),
    "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint": (
        ("transforms", "geometry_msgs/msg/Transform[]"),
        ("velocities", "geometry_msgs/msg/Twist[]"),
        ("accelerations", "geometry_msgs/msg/Twist[]"),
        ("time_from_start", "builtin_interfaces/msg/Duration"),
    ),
    "trajectory_msgs/msg/MultiDOFJointTrajectory": (
        _HEADER,
        ("joint_names", "string[]"),
        ("points", "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint[]"),
    ),
    "moveit_msgs/msg/GripperTranslation": (
        ("direction", "geometry_msgs/msg/Vector3Stamped"),
        ("desired_distance", "float32"),
        ("min_distance", "float32"),
    ),
    "moveit_msgs/msg/Grasp": (
        ("id", "string"),
        ("pre_grasp_posture", "trajectory_msgs/msg/JointTrajectory"),
        ("grasp_posture", "trajectory_msgs/msg/JointTrajectory"),
        ("grasp_pose", "geometry_msgs/msg/PoseStamped"),
        ("grasp_quality", "float64"),
        ("pre_grasp_approach", "moveit_msgs/msg/GripperTranslation"),
        ("post_grasp_retreat", "moveit_msgs/msg/GripperTranslation"),
        ("post_place_retreat", "moveit_msgs/msg/GripperTranslation"),
        ("max_contact_force", "float32"),
        ("allowed_touch_objects", "string[]"),
    ),
}
"""Name of a message -> names and types of its fields, in order; [] after the type of a sequence."""


def cdr(kind: str, message: Any) -> bytes:
    """Return the bytes of a message, with their encapsulation header.

    Args:
        kind: Name of the message, of `MESSAGES`.
        message: Mapping of all its fields, as they stand in YAML.
    """
    body = bytearray()
    _write(body, kind, message)
    return HEADER + bytes(body)


def _write(body: bytearray, kind: str, value: Any) -> None:
    if kind.endswith("[]"):
        element = kind.removesuffix("[]")
        _write_numbers(body, "I", [len(value)])
        if element in NUMBERS:
            _write_numbers(body, NUMBERS[element], value)
            return
        for one in value:
            _write(body, element, one)
    elif kind in NUMBERS:
        _write_numbers(body, NUMBERS[kind], [value])
    elif kind == "string":
        # Half characters of odd file names are escaped, as in texts that are written.
        text = value.encode("utf-8", errors="backslashreplace") + b"\0"
        _write_numbers(body, "I", [len(text)])
        body += text
    else:
        assert value.keys() == dict(MESSAGES[kind]).keys(), kind
        for name, field in MESSAGES[kind]:
            _write(body, field, value[name])


def _write_numbers(body: bytearray, code: str, values: Sequence[float]) -> None:
    """Append numbers, aligned to their size; no padding where there are none."""
    if values:
        body += bytes(-len(body) % struct.calcsize(code))
        body += struct.pack(f"<{len(values)}{code}", *values)
