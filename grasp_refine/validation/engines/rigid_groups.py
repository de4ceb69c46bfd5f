"""Groups of bodies of a MuJoCo model that are welded together: poses and inertias."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.se3 import transform_from_pose


@dataclass(frozen=True, eq=False)
class RigidGroups:
    """Groups of the b bodies of a model; a group is named by its first body, and has that body's frame."""

    first: Int[np.ndarray, " b"]
    """First body (b,) of the group of each body; 0 is the world."""
    T_group_body: Float[np.ndarray, "b 4 4"]
    """Pose (b, 4, 4) of each body in the frame of its group, metres."""
    mass: Float[np.ndarray, " b"]
    """Mass (b,) of the group that the body is the first of; 0 elsewhere; kg."""
    centre: Float[np.ndarray, "b 3"]
    """Centre of mass (b, 3) of these groups, in their frames, metres."""
    inertia: Float[np.ndarray, "b 3 3"]
    """Inertia (b, 3, 3) of these groups about their centres of mass, along the axes of their frames, kg m^2."""

    @classmethod
    def of(cls, model: mujoco.MjModel) -> RigidGroups:
        """Return the groups of a model."""
        first = model.body_weldid.astype(int)
        T = np.tile(np.eye(4), (model.nbody, 1, 1))
        for body in range(1, model.nbody):
            if first[body] != body:
                T[body] = T[model.body_parentid[body]] @ pose_of(model.body_pos[body], model.body_quat[body])
        mass, centre = np.zeros(model.nbody), np.zeros((model.nbody, 3))
        inertia = np.zeros((model.nbody, 3, 3))
        T_inertia = np.stack(
            [T[body] @ pose_of(model.body_ipos[body], model.body_iquat[body]) for body in range(model.nbody)]
        )
        np.add.at(mass, first, model.body_mass)
        np.add.at(centre, first, model.body_mass[:, None] * T_inertia[:, :3, 3])
        centre[mass > 0] /= mass[mass > 0, None]
        for body in range(1, model.nbody):
            axes, arm = T_inertia[body, :3, :3], T_inertia[body, :3, 3] - centre[first[body]]
            about = axes @ np.diag(model.body_inertia[body]) @ axes.T
            inertia[first[body]] += about + model.body_mass[body] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        return cls(first, T, mass, centre, inertia)


def pose_of(position: np.ndarray, quaternion: np.ndarray) -> Float[np.ndarray, "4 4"]:
    """Return the transform of a position (3,) and a quaternion (4,), w first."""
    return transform_from_pose(np.concatenate([position, quaternion]))
