"""Convex pieces as geometry of MuJoCo bodies."""

from __future__ import annotations

import mujoco
import numpy as np

from grasp_refine.geometry.pieces import Piece


def add_piece(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    piece: Piece,
    name: str,
    inertia: mujoco.mjtMeshInertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
) -> mujoco.MjsGeom:
    """Add a geom of a body for one convex piece: a sphere, a capsule, or the hull of its vertices as a mesh.

    Args:
        spec: Specification of the body; a mesh is added to it.
        body: The body, in whose frame the piece is.
        piece: The piece; with a radius and more than two vertices it becomes a polyhedron.
        name: Name of the geom, and of its mesh.
        inertia: Method of MuJoCo for moments of a mesh: by default the hull's; others than this and the shell
            need a surface whose volume is well defined, and only the shell accepts thin or tiny meshes.
    """
    if len(piece.vertices) == 1:
        return body.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[piece.radius, 0, 0], pos=piece.vertices[0]
        )
    if len(piece.vertices) == 2:
        return body.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[piece.radius, 0, 0], fromto=piece.vertices.ravel()
        )
    corners = piece.mesh().vertices if piece.radius > 0 else piece.vertices
    spec.add_mesh(name=name, uservert=np.asarray(corners).ravel(), inertia=inertia)
    return body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)
