"""A second opinion: MuJoCo's distance of two bodies, computed in units in which they are about 1 long."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import mujoco
import numpy as np

from grasp_refine.core.se3 import inverse
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece

MUJOCO_TOLERANCE = 4 * float(np.finfo(np.float32).eps)
"""Allowed error of MuJoCo, as a share of size and distance: it keeps vertices in single precision."""

CUTOFF_DIAGONALS = 1e6
"""Distances beyond this, in diagonals, are ignored by MuJoCo."""


@dataclass(frozen=True, eq=False)
class SecondOpinion:
    """MuJoCo's model of two bodies; built once, queried often."""

    a: Body
    b: Body

    @cached_property
    def unit(self) -> float:
        """The diagonal of the larger body in metres."""
        return max(self.a.diagonal, self.b.diagonal)

    @cached_property
    def _model(self) -> mujoco.MjModel | None:
        """Model with the first body in the world, the second one on a body that moves; None: MuJoCo refuses them."""
        spec = mujoco.MjSpec()
        # Tighter than its defaults, so that the remaining error is its own.
        spec.option.ccd_tolerance, spec.option.ccd_iterations = 1e-10, 200
        moving = spec.worldbody.add_body(mocap=True)
        for body, owner in ((self.a, spec.worldbody), (self.b, moving)):
            for k, piece in enumerate(body.pieces):
                _add(spec, owner, piece, self.unit, f"{body.name} {k}")
        try:
            return spec.compile()
        except ValueError:
            return None

    def distances(self, T_a: np.ndarray, T_b: np.ndarray) -> np.ndarray | None:
        """Return signed distances (N,) in metres at the poses (N, 4, 4); None: MuJoCo refuses such bodies."""
        model = self._model
        if model is None:
            return None
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        moves = model.geom_bodyid > 0
        first, geoms = np.flatnonzero(~moves).tolist(), np.flatnonzero(moves)
        center, R = data.geom_xpos[geoms], data.geom_xmat[geoms].reshape(-1, 3, 3)
        found = []
        for relative in inverse(T_a) @ T_b:
            data.geom_xpos[geoms] = center @ relative[:3, :3].T + relative[:3, 3] / self.unit
            data.geom_xmat[geoms] = (relative[:3, :3] @ R).reshape(-1, 9)
            nearest = CUTOFF_DIAGONALS
            for one, other in product(first, geoms.tolist()):
                nearest = min(nearest, mujoco.mj_geomDistance(model, data, one, other, nearest, None))
            found.append(nearest * self.unit)
        return np.array(found)


def _add(spec: mujoco.MjSpec, owner: mujoco.MjsBody, piece: Piece, unit: float, name: str) -> None:
    """Add the geom of a piece to a body."""
    vertices, radius = piece.vertices / unit, piece.radius / unit
    if len(vertices) == 1:
        owner.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], pos=vertices[0])
    elif len(vertices) == 2:
        owner.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[radius, 0, 0], fromto=vertices.ravel())
    else:
        # A shell, because MuJoCo refuses solids with too little volume.
        spec.add_mesh(
            name=name,
            uservert=vertices.ravel(),
            userface=piece.faces.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        owner.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)
