"""MuJoCo's signed distance of two bodies: a loop of `mj_geomDistance` over all pairs of their pieces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import mujoco
import numpy as np

from grasp_refine.core.se3 import inverse
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece

CUTOFF = 1e6
"""Distances beyond this, in units of the model, are ignored by MuJoCo."""


@dataclass(frozen=True, eq=False)
class MujocoBodies:
    """Two bodies in a model that is built once."""

    a: Body
    b: Body
    unit: float = 1.0
    """Length of the model's unit, metres."""
    precise: bool = False
    """Whether tolerances are tighter than MuJoCo's defaults, so that only the error of its algorithm remains."""

    @cached_property
    def model(self) -> mujoco.MjModel | None:
        """Model with the first body in the world, the second on a body that moves; None: MuJoCo refuses them."""
        spec = mujoco.MjSpec()
        if self.precise:
            spec.option.ccd_tolerance, spec.option.ccd_iterations = 1e-10, 200
        moving = spec.worldbody.add_body(mocap=True)
        for side, (body, owner) in enumerate(((self.a, spec.worldbody), (self.b, moving))):
            for k, piece in enumerate(body.pieces):
                self._add(spec, owner, piece, f"{side} {k}")
        try:
            return spec.compile()
        except ValueError:
            return None

    def _add(self, spec: mujoco.MjSpec, owner: mujoco.MjsBody, piece: Piece, name: str) -> None:
        """Add the geom of a piece to a body."""
        vertices, radius = piece.vertices / self.unit, piece.radius / self.unit
        if len(vertices) == 1:
            owner.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], pos=vertices[0])
        elif len(vertices) == 2:
            owner.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[radius, 0, 0], fromto=vertices.ravel())
        else:
            # A shell, because MuJoCo refuses solids with too little volume.
            shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            spec.add_mesh(name=name, uservert=vertices.ravel(), userface=piece.faces.ravel(), inertia=shell)
            owner.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)

    def loop(self, T_a: np.ndarray, T_b: np.ndarray) -> Callable[[], np.ndarray]:
        """Return the loop that finds the signed distances (N,) in metres at poses (N, 4, 4), the best one as cutoff."""
        model, unit = self.model, self.unit
        assert model is not None, "MuJoCo refuses these bodies"
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        moves = model.geom_bodyid > 0
        first, geoms = np.flatnonzero(~moves).tolist(), np.flatnonzero(moves)
        # Poses of geoms are computed beforehand, which favours MuJoCo.
        center, R = data.geom_xpos[geoms], data.geom_xmat[geoms].reshape(-1, 3, 3)
        relative = inverse(T_a) @ T_b
        centers = center @ relative[:, :3, :3].mT + relative[:, None, :3, 3] / unit
        turns = (relative[:, None, :3, :3] @ R).reshape(len(relative), -1, 9)
        pairs_of_geoms = list(product(first, geoms.tolist()))
        segment = np.zeros(6)

        def run() -> np.ndarray:
            found = []
            for position, turn in zip(centers, turns, strict=True):
                data.geom_xpos[geoms], data.geom_xmat[geoms] = position, turn
                best = CUTOFF
                for a, b in pairs_of_geoms:
                    d = mujoco.mj_geomDistance(model, data, a, b, best, segment)
                    if d < best:
                        best, _ = d, segment.copy()
                found.append(best)
            return unit * np.array(found)

        return run
