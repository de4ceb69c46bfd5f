"""Grasps to export: one hand on one object, with all that another program needs to use them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from grasp_refine.closing.motion import STAGES, Motion
from grasp_refine.core.array_types import Float, Int, Shaped
from grasp_refine.core.se3 import pose_from_transform
from grasp_refine.core.short_repr import brief
from grasp_refine.forces.squeeze_forces import ContactForces
from grasp_refine.hands.files.urdf_text import UNLIMITED
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.palm import palm_poses
from grasp_refine.motion.trajectory_context import all_values
from grasp_refine.objects.object import Object
from grasp_refine.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class ExportedGrasps:
    """N grasps of one hand on one object at one scale."""

    name: str
    """Name of the object in the grasp file."""
    scale: float
    """Factor that takes the object's mesh to metres."""
    scene: Scene
    """Hand, object, task and grasps."""
    motion: Motion
    """Pregrasps, grasps and squeezes."""
    index: Int[np.ndarray, " N"]
    """Numbers (N,) of the grasps within their object."""
    forces: ContactForces | None = None
    """Forces that the squeezes are planned for, by grasp; None: the squeezes are not ours."""
    values: Mapping[str, Shaped[np.ndarray, " N"]] = field(default_factory=dict)
    """Measures, verdicts and words of each grasp (N,), by their names in result files."""

    __repr__ = brief

    def __len__(self) -> int:
        """Return the number of grasps N."""
        return len(self.motion)

    @property
    def hand(self) -> Hand:
        """The hand, on its arm where it has one."""
        return self.scene.hand

    @property
    def object(self) -> Object:
        """The object, in metres."""
        return self.scene.object

    @cached_property
    def speed_limits(self) -> Mapping[str, float]:
        """Speed limits, rad/s or m/s, of the joints of the simulated model that have one, by name."""
        joints, names = self.hand.joints_by_name, self.hand.mjcf_joints
        limits = {names.get(name, name): joint.velocity for name, joint in joints.items()}
        return {name: limit for name, limit in limits.items() if limit is not None and limit < UNLIMITED}

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of all m movable joints, with followers of others, in the order of `joint_values`."""
        return self.hand.mimic_map()[2]

    @cached_property
    def joint_values(self) -> Float[np.ndarray, "N 3 m"]:
        """Values (N, 3, m) of all movable joints at the stages, rad or m, followers included."""
        return all_values(self.hand, self.motion.q)

    @cached_property
    def poses(self) -> Float[np.ndarray, "N 3 7"]:
        """Poses (N, 3, 7) of the base link in the object's frame at the stages: x y z (m), qw qx qy qz."""
        return pose_from_transform(self.motion.T_world_root)

    @cached_property
    def palm_poses(self) -> Float[np.ndarray, "N 3 7"]:
        """Poses (N, 3, 7) of the palm likewise: of the base link, or of the hand that an arm carries."""
        flat = self.motion.T_world_root.reshape(-1, 4, 4), self.motion.q.reshape(len(self) * len(STAGES), -1)
        return pose_from_transform(palm_poses(self.hand, *flat)).reshape(len(self), len(STAGES), 7)
