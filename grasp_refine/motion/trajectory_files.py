"""Files of trajectories, JSON or .npz: waypoints and timed set points with all that a robot needs to follow them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import dumps, save_text
from grasp_refine.core.npz_files import save_npz
from grasp_refine.core.plurals import first_of
from grasp_refine.core.se3 import inverse, pose_from_transform
from grasp_refine.core.short_repr import brief
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.palm import palm_poses
from grasp_refine.motion.executions import Executions
from grasp_refine.motion.plan import LEGS, REACH, MotionPlan
from grasp_refine.motion.trajectory import PERIOD_S, POINTS, Trajectory, trajectory
from grasp_refine.motion.trajectory_context import (
    CONVENTIONS,
    all_values,
    as_text,
    joint_arrays,
    joint_entries,
    pressing_torques,
    robot_entry,
    scene_entry,
)
from grasp_refine.scene.scene import Scene

SCHEMA = 2
"""Version of the layout."""

SUFFIXES = (".npz", ".json")
"""Suffixes of files of trajectories."""

AT_WAYPOINTS = ("q", "palm_pose", "palm_pose_base")
"""Numbers that waypoints have, too."""


@dataclass(frozen=True, eq=False)
class PlannedTrajectories:
    """The trajectories of N grasps of one hand."""

    hand: Hand
    """The hand, or the hand on its arm."""
    object: np.ndarray
    """Names of the objects (N,)."""
    row: np.ndarray
    """Rows of the grasps (N,) in their file."""
    index: np.ndarray
    """Numbers of the grasps (N,) within their object."""
    plans: tuple[MotionPlan, ...]
    """The trajectories."""
    scenes: tuple[tuple[Scene, float], ...] = ()
    """Scene of each grasp, and the scale of its object, N of them; none: surroundings of the hand are not written."""
    executions: Executions | None = None
    """The free ones as they were followed in simulation; None: they were not."""

    __repr__ = brief

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.plans)

    @property
    def free(self) -> np.ndarray:
        """True (N,) where the trajectory is free."""
        return np.array([plan.free for plan in self.plans], dtype=bool)

    def trajectories(self) -> tuple[Trajectory, ...]:
        """Return the trajectories with times by the speed limits of the joints."""
        return tuple(trajectory(self.hand, plan) for plan in self.plans)

    def lines(self, most: int = 5) -> list[str]:
        """Return lines for people: the number of free trajectories, and the obstacles of others, `most` of them."""
        other = sum(plan.other_arm for plan in self.plans)
        beside = f", in {other} of them with the arm in another configuration than the grasp's" if other else ""
        lines = [f"the trajectory is free in {int(self.free.sum())} of {len(self)}{beside}"]
        several, named = len(set(self.object.tolist())) > 1, zip(self.object, self.index, strict=True)
        labels = [f"{name} {index}" if several else str(index) for name, index in named]
        others = [(label, plan) for label, plan in zip(labels, self.plans, strict=True) if not plan.free]
        lines += first_of(
            [f"trajectory of grasp {label} {plan.status.label}: {plan.why}" for label, plan in others], most
        )
        return lines if self.executions is None else lines + self.executions.lines(most, labels)

    def entry(self, number: int) -> dict[str, Any]:
        """Return the state of the trajectory of a grasp for JSON; SI units."""
        plan = self.plans[number]
        return {
            "status": plan.status.label,
            "why": plan.why,
            "other_arm_configuration": plan.other_arm,
            **({} if self.executions is None else {"followed": self.executions.document(number)}),
        }

    def save(self, path: str | Path) -> None:
        """Write them: .npz with arrays of all grasps, or .json with an entry for each.

        Both hold the same: set points of all joints with velocities and the poses of base and palm at even times,
        waypoints, joints with their servos, object, table and scene, and `CONVENTIONS` in words.

        Raises:
            GraspRefineError: another suffix, or the file cannot be written.
        """
        path = Path(path)
        check_trajectory_file(path)
        if path.suffix == ".json":
            # On one line: of each number on its own the file would be twice as large.
            save_text(path, dumps(self.document()) + "\n")
        else:
            save_npz(path, self.arrays())

    def document(self) -> dict[str, Any]:
        """Return the contents of a JSON file."""
        hand, (scenes, scene_of) = self.hand, self._scenes()
        timed = self.trajectories()
        joints = joint_entries(hand)
        return {
            "schema": SCHEMA,
            "conventions": CONVENTIONS,
            "hand": hand.name,
            "base_link": hand.base_link,
            "palm": hand.palm,
            "robot": robot_entry(hand),
            "joint_names": [joint["name"] for joint in joints],
            "arm_joints": [name for name, arm in zip(hand.joint_names, hand.arm_joints, strict=True) if arm],
            "joints": joints,
            "legs": [REACH, *LEGS],
            "period_s": PERIOD_S,
            "scenes": scenes,
            "grasps": [
                {
                    "object": str(self.object[number]),
                    "row": int(self.row[number]),
                    "scene": scene_of[number],
                    **self.entry(number),
                    "waypoints": _waypoints(hand, one),
                    "squeeze": _squeeze(hand, one, joints),
                    "trajectory": {"time_s": one.time, **_numbers(hand, one)},
                }
                for number, one in enumerate(timed)
            ],
        }

    def arrays(self) -> dict[str, Any]:
        """Return the arrays of an .npz file; NaN after the end of a trajectory, and where a waypoint is not known."""
        hand, count, (scenes, scene_of) = self.hand, len(self), self._scenes()
        timed = self.trajectories()
        longest, joints = max((len(one) for one in timed), default=0), joint_entries(hand)
        points, m = len(POINTS), len(joints)
        time = np.full((count, longest), np.nan)
        widths = {"q": m, "velocity": m, "base_pose": 7, "palm_pose": 7, "palm_pose_base": 7}
        numbers = {key: np.full((count, longest, width), np.nan) for key, width in widths.items()}
        at_points = {key: np.full((count, points, widths[key]), np.nan) for key in AT_WAYPOINTS}
        index, torque = np.full((count, points), -1), np.full((count, m), np.nan)
        for row, one in enumerate(timed):
            if not len(one):
                continue
            time[row, : len(one)] = one.time
            places = [POINTS.index(name) for name in one.named]
            index[row, places] = one.waypoints
            for key, values in _numbers(hand, one).items():
                numbers[key][row, : len(one)] = values
            for key, values in at_points.items():
                values[row, places] = numbers[key][row, list(one.waypoints)]
            if "squeeze" in one.named:
                torque[row] = pressing_torques(hand, one.q[[one.named["grasp"], one.named["squeeze"]]])
        return {
            "schema": np.array(SCHEMA),
            "conventions": as_text(CONVENTIONS),
            "hand": np.array(hand.name),
            "base_link": np.array(hand.base_link),
            "palm": np.array(hand.palm),
            "robot": as_text(robot_entry(hand)),
            **joint_arrays(joints),
            "object": np.asarray(self.object, dtype=np.str_),
            "row": np.asarray(self.row),
            "scenes": as_text(scenes),
            "scene": np.array([-1 if number is None else number for number in scene_of]),
            "status": np.array([plan.status.label for plan in self.plans]),
            "why": np.array([plan.why for plan in self.plans]),
            "other_arm_configuration": np.array([plan.other_arm for plan in self.plans], dtype=bool),
            "period": np.array(PERIOD_S),
            "time": time,
            **numbers,
            "legs": np.array((REACH, *LEGS)),
            "waypoint_names": np.array(POINTS),
            "waypoint_index": index,
            **{f"waypoint_{key}": values for key, values in at_points.items()},
            "squeeze_torque": torque,
            **({} if self.executions is None else self.executions.arrays()),
        }

    def _scenes(self) -> tuple[list[dict[str, Any]], list[int | None]]:
        """Return an entry for each different scene, and the number of that of each grasp; None: it is not known."""
        if not self.scenes:
            return [], [None] * len(self)
        different = {id(scene): (scene, scale) for scene, scale in self.scenes}
        number = {key: place for place, key in enumerate(different)}
        return [scene_entry(*each) for each in different.values()], [number[id(scene)] for scene, _ in self.scenes]


def check_trajectory_file(path: Path) -> None:
    """Refuse a file of trajectories of another kind.

    Raises:
        GraspRefineError: its suffix is neither .npz nor .json.
    """
    if path.suffix not in SUFFIXES:
        raise GraspRefineError(f"{path}: trajectories are written to .npz or .json, not '{path.suffix}'")


def join(parts: Sequence[PlannedTrajectories], order: np.ndarray) -> PlannedTrajectories:
    """Return trajectories of several groups of grasps as one, in another order."""
    plans = [plan for part in parts for plan in part.plans]
    labels = {key: np.concatenate([getattr(part, key) for part in parts])[order] for key in ("object", "row", "index")}
    scenes = [scene for part in parts for scene in part.scenes]
    plans, scenes = ([entries[place] for place in order.tolist()] if entries else [] for entries in (plans, scenes))
    return PlannedTrajectories(parts[0].hand, **labels, plans=tuple(plans), scenes=tuple(scenes))


def _numbers(hand: Hand, timed: Trajectory) -> dict[str, np.ndarray]:
    """Return values (K, m) of all joints, their velocities, and poses (K, 7), at the set points."""
    values, T_root = all_values(hand, timed.q), timed.T_world_root
    T_palm = palm_poses(hand, T_root, timed.q)
    poses = {"base_pose": T_root, "palm_pose": T_palm, "palm_pose_base": inverse(T_root) @ T_palm}
    found = {"q": values, "velocity": timed.velocity(values)}
    return found | {key: pose_from_transform(T) for key, T in poses.items()}


def _waypoints(hand: Hand, timed: Trajectory) -> list[dict[str, Any]]:
    numbers = _numbers(hand, timed)
    return [
        {"name": name, "index": place, "time_s": timed.time[place]} | {key: numbers[key][place] for key in AT_WAYPOINTS}
        for name, place in timed.named.items()
    ]


def _squeeze(hand: Hand, timed: Trajectory, joints: Sequence[dict[str, Any]]) -> dict[str, float] | None:
    """Return the torques of the joints that press, by name; None where the trajectory ends before the squeeze."""
    if "squeeze" not in timed.named:
        return None
    torque = pressing_torques(hand, timed.q[[timed.named["grasp"], timed.named["squeeze"]]])
    return {joint["name"]: value for joint, value in zip(joints, torque.tolist(), strict=True) if value}
