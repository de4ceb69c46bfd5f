"""Points of the geoms of a MuJoCo model, for engines that make hulls of them."""

from __future__ import annotations

import mujoco
import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.geometry.sphere_points import on_sphere

ROUND_POINTS = 120
"""Number of vertices of the hull in place of a sphere, capsule, cylinder or ellipsoid."""


def geom_points(model: mujoco.MjModel, geom: int) -> Float[np.ndarray, "v 3"]:
    """Return points (v, 3) whose hull is a geom, in its frame; round ones have some on their surface.

    Raises:
        GraspRefineError: a kind of geom without a hull.
    """
    kind, (a, b, c) = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        start = model.mesh_vertadr[mesh]
        return model.mesh_vert[start : start + model.mesh_vertnum[mesh]].astype(float)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return model.geom_size[geom] * np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        turn = np.linspace(0.0, 2.0 * np.pi, ROUND_POINTS // 2, endpoint=False)
        ring = np.column_stack([a * np.cos(turn), a * np.sin(turn), np.full(len(turn), b)])
        return np.concatenate([ring, ring * [1.0, 1.0, -1.0]])
    ball = on_sphere(ROUND_POINTS)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return a * ball
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return a * ball + np.where(ball[:, 2:] > 0, b, -b) * [0.0, 0.0, 1.0]
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return ball * [a, b, c]
    raise GraspRefineError(f"geometry '{kind.name}' of the hand is exported to mjcf only")
