"""Target `ros2`: messages of MoveIt and of joint trajectory controllers, as YAML and as CDR bytes; without ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.closing.motion import STAGES
from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import save_bytes
from grasp_refine.core.plurals import first_of
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.export.cdr import cdr
from grasp_refine.export.exported import ExportedGrasps
from grasp_refine.export.target import Readme
from grasp_refine.export.timed import timed
from grasp_refine.grasps.formats.texts import dump_yaml
from grasp_refine.hands.palm import palm_poses
from grasp_refine.motion.plan import MotionPlan, TrajectoryOptions, closing_paths, plan_motions, up_of
from grasp_refine.motion.trajectory import Trajectory
from grasp_refine.motion.trajectory_context import all_values, pressing_torques

GRASP, TRAJECTORY = "moveit_msgs/msg/Grasp", "trajectory_msgs/msg/JointTrajectory"
PALM_TRAJECTORY = "trajectory_msgs/msg/MultiDOFJointTrajectory"

LEAST_SHARE = 0.5
"""Share of an approach, or of a retreat, that is its least feasible distance."""

Message = dict[str, Any]
"""Fields of a message."""


@dataclass(frozen=True)
class Ros2:
    """Messages for MoveIt and for joint trajectory controllers."""

    name: str = "ros2"
    what: str = "moveit_msgs/Grasp, trajectories of joints and palm of each grasp, as YAML and as CDR bytes"
    extra: str = ""

    def write(self, grasps: ExportedGrasps, folder: Path) -> Readme:
        """Write the messages of each grasp.

        Raises:
            GraspRefineError: no grasp has a pose and joint values that are finite.
        """
        hand, frame = grasps.hand, _frame(grasps)
        plans = plan_motions(grasps.scene, grasps.motion)
        rows = [row for row, plan in enumerate(plans) if plan.direction is not None]
        if not rows:
            raise GraspRefineError(f"{grasps.name}: no grasp can be written as a message: {plans[0].why}")
        for row in rows:
            moved = timed(grasps, plans[row], row)
            ends = ", ".join(f"{name} at {moved.time[place]:.2f} s" for name, place in _ends(moved).items())
            _save(folder / "grasps" / str(row), GRASP, grasp_message(grasps, plans[row], row))
            _save(folder / "trajectories" / str(row), TRAJECTORY, trajectory_message(grasps, moved), ends)
            if hand.arm is None:
                _save(folder / "palms" / str(row), PALM_TRAJECTORY, palm_message(grasps, moved), ends)
        palm = hand.palm
        followers = [name for name in grasps.joint_names if name not in hand.joint_names]
        beyond = [f"Grasp {row} is left out: {plan.why}." for row, plan in enumerate(plans) if plan.direction is None]
        blocked = [
            f"The motion of grasp {row} is not free: {plan.why}."
            for row, plan in enumerate(plans)
            if plan.direction is not None and not plan.free
        ]
        files = {
            "grasps/K.yaml, grasps/K.cdr": f"{GRASP} of grasp K",
            "trajectories/K.yaml, trajectories/K.cdr": f"{TRAJECTORY} from the approach, or where it is blocked the "
            "pregrasp; its first line has the times",
        }
        if hand.arm is None:
            files["palms/K.yaml, palms/K.cdr"] = f"{PALM_TRAJECTORY}: poses of link `{palm}` at the same times"
        return Readme(
            files,
            use=f"ros2 topic pub --once --stdin /grasp {GRASP} < grasps/{rows[0]}.yaml",
            notes=(
                "In Python, `rclpy.serialization.deserialize_message(content of a .cdr, class of its message)`.",
                f"frame_id `{frame}` is the frame of the object's mesh: publish its pose on /tf, or put the pose into "
                "grasp_pose and the three directions.",
                f"grasp_pose is the pose of link `{palm}`; quaternions are x y z w; metres, radians, newtons.",
                "A trajectory begins at rest in its first point: be there before it is sent.",
                *([f"Postures also have the joints that follow others: {', '.join(followers)}."] if followers else ()),
                *([] if grasps.forces is not None else ["max_contact_force is 0: forces are not known."]),
                *first_of(beyond, 5),
                *first_of(blocked, 5),
            ),
        )


def grasp_message(grasps: ExportedGrasps, plan: MotionPlan, row: int) -> Message:
    """Return the `moveit_msgs/msg/Grasp` of a grasp.

    The approach leads from the start of the plan to the grasp, in the object's frame. The posture of the grasp has two
    points: the grasp, and the set points of the squeeze; both have the torques with which the joints press.

    Args:
        grasps: The grasps.
        plan: Plan of this one, with a direction of approach.
        row: Its row.
    """
    hand, options = grasps.hand, TrajectoryOptions()
    opened, grasp, squeeze = _fingers(grasps, plan, row)
    pregrasp, at = (grasps.palm_poses[row, STAGES.index(name)] for name in ("pregrasp", "grasp"))
    away = np.array(plan.direction)
    effort = pressing_torques(hand, np.stack([grasp, squeeze]))
    quality = float(grasps.values["quality"][row]) if "quality" in grasps.values else 0.0
    force = 0.0
    if grasps.forces is not None:
        force = float(np.linalg.norm(grasps.forces.vector[grasps.forces.grasp == row], axis=1).max(initial=0.0))
    return {
        "id": f"{grasps.name}_{grasps.index[row]}",
        "pre_grasp_posture": _posture(grasps, [opened]),
        "grasp_posture": _posture(grasps, [grasp, squeeze], effort),
        "grasp_pose": {
            "header": _header(_frame(grasps)),
            "pose": _place(at, "position", "orientation"),
        },
        "grasp_quality": quality if np.isfinite(quality) else 0.0,
        "pre_grasp_approach": _translation(grasps, at[:3] - pregrasp[:3] - options.approach * away),
        "post_grasp_retreat": _translation(grasps, options.lift * up_of(grasps.scene)),
        "post_place_retreat": _translation(grasps, options.approach * away),
        "max_contact_force": force,
        "allowed_touch_objects": [_frame(grasps)],
    }


def trajectory_message(grasps: ExportedGrasps, timed: Trajectory) -> Message:
    """Return the `trajectory_msgs/msg/JointTrajectory` of a trajectory: its joints that are driven.

    It has no efforts, which controllers refuse in trajectories of positions.
    """
    velocity = timed.velocity(timed.q)
    points = [_point(q, time, rate) for q, time, rate in zip(timed.q, timed.time, velocity, strict=True)]
    return {"header": _header(""), "joint_names": list(grasps.hand.joint_names), "points": points}


def palm_message(grasps: ExportedGrasps, timed: Trajectory) -> Message:
    """Return the `trajectory_msgs/msg/MultiDOFJointTrajectory` of the palm: its poses in the object's frame."""
    poses = pose_from_transform(palm_poses(grasps.hand, timed.T_world_root, timed.q))
    points = [
        {
            "transforms": [_place(pose, "translation", "rotation")],
            "velocities": [],
            "accelerations": [],
            "time_from_start": _duration(time),
        }
        for pose, time in zip(poses, timed.time.tolist(), strict=True)
    ]
    return {"header": _header(_frame(grasps)), "joint_names": [grasps.hand.palm], "points": points}


def _place(pose: Float[np.ndarray, " 7"], position: str, rotation: str) -> Message:
    """Return a pose, its position and its quaternion under these names."""
    x, y, z, qw, qx, qy, qz = pose.tolist()
    return {position: {"x": x, "y": y, "z": z}, rotation: {"x": qx, "y": qy, "z": qz, "w": qw}}


def _ends(timed: Trajectory) -> dict[str, int]:
    """Return the places of the waypoints of a trajectory by name, of one without an approach as well."""
    every = len(timed.waypoints) > len(STAGES)
    return timed.named if every else dict(zip(STAGES, timed.waypoints, strict=True))


def _fingers(grasps: ExportedGrasps, plan: MotionPlan, row: int) -> Sequence[Float[np.ndarray, " n"]]:
    """Return joint values (n,) of the hand as it comes, at the grasp, and as it presses."""
    close, press = closing_paths(grasps.hand, grasps.motion.T_world_root[row], grasps.motion.q[row])
    return plan.legs[0].q[0] if plan.free else close.q[0], close.q[1], press.q[1]


def _posture(
    grasps: ExportedGrasps, stages: Sequence[Float[np.ndarray, " n"]], effort: Float[np.ndarray, " m"] | None = None
) -> Message:
    """Return the joints of the hand alone, with followers of others, at some stages, a second apart."""
    # Joints of the arm hang from links that are not at or below the palm.
    of_arm, joints = () if grasps.hand.arm is None else grasps.hand.arm.links, grasps.hand.joints_by_name
    mine = np.array([joints[name].parent not in of_arm for name in grasps.joint_names])
    values = all_values(grasps.hand, np.stack(stages))[:, mine]
    torque = None if effort is None else effort[mine]
    return {
        "header": _header(""),
        "joint_names": np.array(grasps.joint_names)[mine].tolist(),
        "points": [_point(one, float(time), effort=torque) for time, one in enumerate(values)],
    }


def _point(
    positions: np.ndarray, time: float, velocities: np.ndarray | None = None, effort: np.ndarray | None = None
) -> Message:
    return {
        "positions": positions.tolist(),
        "velocities": [] if velocities is None else velocities.tolist(),
        "accelerations": [],
        "effort": [] if effort is None else effort.tolist(),
        "time_from_start": _duration(time),
    }


def _duration(time: float) -> Message:
    sec, nanosec = divmod(round(time * 1e9), 10**9)
    return {"sec": sec, "nanosec": nanosec}


def _translation(grasps: ExportedGrasps, along: Float[np.ndarray, " 3"]) -> Message:
    """Return the `GripperTranslation` along a vector (m) in the object's frame."""
    length = float(np.linalg.norm(along))
    x, y, z = (along / length).tolist() if length else (0.0, 0.0, 1.0)
    return {
        "direction": {"header": _header(_frame(grasps)), "vector": {"x": x, "y": y, "z": z}},
        "desired_distance": length,
        "min_distance": LEAST_SHARE * length,
    }


def _header(frame: str) -> Message:
    """Return a header at time 0: transforms are the latest ones."""
    return {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}


def _frame(grasps: ExportedGrasps) -> str:
    """Return the frame of the object: its name, which must not begin with a slash."""
    return grasps.name.lstrip("/")


def _save(path: Path, kind: str, message: Message, more: str = "") -> None:
    head = f"# {kind}{more and ': '}{more}\n".encode()
    save_bytes(path.with_name(f"{path.name}.yaml"), head + dump_yaml(message))
    save_bytes(path.with_name(f"{path.name}.cdr"), cdr(kind, message))
