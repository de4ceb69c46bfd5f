"""Files of ways, JSON or .npz: waypoints and timed set points, that a robot can follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.json_files import save_json
from grasp_refine.core.npz_files import save_npz
from grasp_refine.core.plurals import first_of
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.core.short_repr import brief
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.palm import palm_poses
from grasp_refine.motion.executions import Executions
from grasp_refine.motion.trajectory import Trajectory, trajectory
from grasp_refine.motion.way import LEGS, WAYPOINTS, Way

SCHEMA = 1
"""Version of the layout."""

SUFFIXES = (".npz", ".json")
"""Suffixes of files of ways."""


@dataclass(frozen=True, eq=False)
class PlannedWays:
    """The ways of N grasps of one hand."""

    hand: Hand
    """The hand, or the hand on its arm."""
    object: np.ndarray
    """Names of the objects (N,)."""
    row: np.ndarray
    """Rows of the grasps (N,) in their file."""
    index: np.ndarray
    """Numbers of the grasps (N,) among those of their object."""
    ways: tuple[Way, ...]
    """The ways."""
    executions: Executions | None = None
    """The free ones as they were followed in simulation; None: they were not."""

    __repr__ = brief

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.ways)

    @property
    def free(self) -> np.ndarray:
        """True (N,) where the whole way is free."""
        return np.array([way.free for way in self.ways], dtype=bool)

    def trajectories(self) -> tuple[Trajectory, ...]:
        """Return the ways with times by the speed limits of the joints."""
        return tuple(trajectory(self.hand, way) for way in self.ways)

    def lines(self, most: int = 5) -> list[str]:
        """Return lines for people: how many ways are free, and what is in the others, `most` of them."""
        other = sum(way.other_arm for way in self.ways)
        beside = f", in {other} of them with the arm in another configuration than the grasp's" if other else ""
        lines = [f"the whole way is free in {int(self.free.sum())} of {len(self)}{beside}"]
        several, named = len(set(self.object.tolist())) > 1, zip(self.object, self.index, strict=True)
        labels = [f"{name} {index}" if several else str(index) for name, index in named]
        others = [(label, way) for label, way in zip(labels, self.ways, strict=True) if not way.free]
        lines += first_of([f"way of grasp {label} {way.status.label}: {way.why}" for label, way in others], most)
        return lines if self.executions is None else lines + self.executions.lines(most, labels)

    def entry(self, number: int) -> dict[str, Any]:
        """Return what is known of the way of a grasp for JSON; SI units."""
        way = self.ways[number]
        return {
            "status": way.status.label,
            "why": way.why,
            "other_arm_configuration": way.other_arm,
            **({} if self.executions is None else {"followed": self.executions.document(number)}),
        }

    def save(self, path: str | Path) -> None:
        """Write them: .npz with arrays of all grasps, or .json with an entry for each.

        Metres, radians, seconds; poses are x y z qw qx qy qz in the object's frame. Set points of fingers that press
        lie beyond where they rest on the object.

        Raises:
            GraspRefineError: another suffix, or the file cannot be written.
        """
        path = Path(path)
        check_way_file(path)
        if path.suffix == ".json":
            save_json(path, self.document())
        else:
            save_npz(path, self.arrays())

    def document(self) -> dict[str, Any]:
        """Return the contents of a JSON file."""
        hand = self.hand
        return {
            "schema": SCHEMA,
            "hand": hand.name,
            "base_link": hand.base_link,
            "palm": hand.palm,
            "joint_names": list(hand.joint_names),
            "arm_joints": [name for name, arm in zip(hand.joint_names, hand.arm_joints, strict=True) if arm],
            "legs": list(LEGS),
            "grasps": [
                {
                    "object": str(name),
                    "row": int(row),
                    **self.entry(number),
                    "waypoints": _waypoints(hand, timed),
                    "trajectory": {
                        "time_s": timed.time.tolist(),
                        "base_pose": pose_from_transform(timed.T_world_root).tolist(),
                        "q": timed.q.tolist(),
                    },
                }
                for number, (name, row, timed) in enumerate(
                    zip(self.object, self.row, self.trajectories(), strict=True)
                )
            ],
        }

    def arrays(self) -> dict[str, Any]:
        """Return the arrays of an .npz file; NaN after the end of a way, and where a waypoint is not known."""
        hand, count = self.hand, len(self)
        timed = self.trajectories()
        longest = max((len(one) for one in timed), default=0)
        n, points = len(hand.joint_names), len(WAYPOINTS)
        time, q = np.full((count, longest), np.nan), np.full((count, longest, n), np.nan)
        pose, waypoint_time = np.full((count, longest, 7), np.nan), np.full((count, points), np.nan)
        waypoint_q, waypoint_palm = np.full((count, points, n), np.nan), np.full((count, points, 7), np.nan)
        for row, one in enumerate(timed):
            if not len(one):
                continue
            time[row, : len(one)], q[row, : len(one)] = one.time, one.q
            pose[row, : len(one)] = pose_from_transform(one.T_world_root)
            at = np.array(one.waypoints)
            waypoint_time[row, : len(at)], waypoint_q[row, : len(at)] = one.time[at], one.q[at]
            palm = pose_from_transform(palm_poses(hand, one.T_world_root[at], one.q[at]))
            waypoint_palm[row, : len(at)] = palm
        return {
            "schema": np.array(SCHEMA),
            "hand": np.array(hand.name),
            "base_link": np.array(hand.base_link),
            "palm": np.array(hand.palm),
            "joint_names": np.array(hand.joint_names),
            "object": np.asarray(self.object, dtype=np.str_),
            "row": np.asarray(self.row),
            "status": np.array([way.status.label for way in self.ways]),
            "why": np.array([way.why for way in self.ways]),
            "other_arm_configuration": np.array([way.other_arm for way in self.ways], dtype=bool),
            "time": time,
            "q": q,
            "base_pose": pose,
            "waypoint_names": np.array(WAYPOINTS),
            "waypoint_time": waypoint_time,
            "waypoint_q": waypoint_q,
            "waypoint_palm_pose": waypoint_palm,
            **({} if self.executions is None else self.executions.arrays()),
        }


def check_way_file(path: Path) -> None:
    """Refuse a file of ways of another kind.

    Raises:
        GraspRefineError: its suffix is neither .npz nor .json.
    """
    if path.suffix not in SUFFIXES:
        raise GraspRefineError(f"{path}: ways are written to .npz or .json, not '{path.suffix}'")


def join(parts: Sequence[PlannedWays], order: np.ndarray) -> PlannedWays:
    """Return ways of several groups of grasps as one, in another order."""
    ways = [way for part in parts for way in part.ways]
    labels = {key: np.concatenate([getattr(part, key) for part in parts])[order] for key in ("object", "row", "index")}
    return PlannedWays(parts[0].hand, **labels, ways=tuple(ways[place] for place in order.tolist()))


def _waypoints(hand: Hand, timed: Trajectory) -> list[dict[str, Any]]:
    at = np.array(timed.waypoints, dtype=np.int64)
    if not len(at):
        return []
    palm = pose_from_transform(palm_poses(hand, timed.T_world_root[at], timed.q[at]))
    return [
        {"name": name, "time_s": float(timed.time[place]), "palm_pose": pose.tolist(), "q": timed.q[place].tolist()}
        for name, place, pose in zip(WAYPOINTS, at.tolist(), palm, strict=False)
    ]
