"""Collision geometry of a MuJoCo model in PhysX, its material, and the pairs of shapes that can touch."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import transform
from grasp_refine.validation.engines.geom_points import geom_points
from grasp_refine.validation.engines.physx.binding import physx, pose_of_transform

CONTACT_OFFSET_M = 1e-3
"""Distance between two shapes, over 2, from which on the solver knows of their contact."""

HULL_UNIT_M = 1e-3
"""Unit in which hulls are made: PhysX drops vertices within 0.7 of its unit of a face, 0.7 mm in metres. It keeps at
most 255 faces, so that hulls of several hundred vertices lie up to 0.2 mm inside."""

MAX_CLASSES = 32
"""Largest number of classes of shapes with equal partners: bits of PhysX's filter."""

ALONG_X = transform(np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]), np.zeros(3))
"""Transform of the x axis, along which PhysX has axes of symmetry and normals, to the z axis of MuJoCo's shapes."""


def material_of(friction: float) -> physx.PhysxMaterial:
    """Return a material with static and sliding friction, without restitution."""
    return physx.PhysxMaterial(friction, friction, 0.0)


def shape_of(
    model: mujoco.MjModel,
    geom: int,
    T_link_geom: Float[np.ndarray, "4 4"],
    material: physx.PhysxMaterial,
) -> physx.PhysxCollisionShape:
    """Return the shape of a geom in the frame of its link.

    Args:
        model: The model.
        geom: Number of the geom.
        T_link_geom: Pose (4, 4) of the geom in the frame of the link.
        material: Its material.

    Raises:
        GraspRefineError: a kind of geom that PhysX has no counterpart of.
    """
    kind, size, T = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom], T_link_geom
    if kind in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        shape = _hull(geom_points(model, geom), material)
    elif kind == mujoco.mjtGeom.mjGEOM_BOX:
        shape = physx.PhysxCollisionShapeBox(size, material)
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        shape = physx.PhysxCollisionShapeSphere(size[0], material)
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        shape, T = physx.PhysxCollisionShapeCapsule(size[0], size[1], material), T @ ALONG_X
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        shape, T = physx.PhysxCollisionShapeCylinder(size[0], size[1], material), T @ ALONG_X
    elif kind == mujoco.mjtGeom.mjGEOM_PLANE:
        shape, T = physx.PhysxCollisionShapePlane(material), T @ ALONG_X
    else:
        raise GraspRefineError(
            f"engine physx has no geometry like geom '{model.geom(geom).name}' of MuJoCo: {kind.name}"
        )
    shape.set_local_pose(pose_of_transform(T))
    shape.set_contact_offset(CONTACT_OFFSET_M)
    shape.set_rest_offset(0.0)
    return shape


def _hull(points: np.ndarray, material: physx.PhysxMaterial) -> physx.PhysxCollisionShape:
    from scipy.spatial import ConvexHull

    corners = points[ConvexHull(points).vertices] / HULL_UNIT_M
    return physx.PhysxCollisionShapeConvexMesh(corners.astype(np.float32), np.full(3, HULL_UNIT_M), material)


def let_collide(shapes: Sequence[physx.PhysxCollisionShape | None], pairs: Sequence[tuple[int, int]]) -> None:
    """Let these pairs of shapes collide, and no others.

    Raises:
        GraspRefineError: more shapes with different partners than PhysX's filter has bits.
    """
    partners: dict[int, set[int]] = {}
    for a, b in pairs:
        partners.setdefault(a, set()).add(b)
        partners.setdefault(b, set()).add(a)
    # Shapes with equal partners, such as all of a link, share a bit; none is its own partner.
    classes = {kind: bit for bit, kind in enumerate(dict.fromkeys(map(frozenset, partners.values())))}
    if len(classes) > MAX_CLASSES:
        raise GraspRefineError(
            f"engine physx distinguishes at most {MAX_CLASSES} kinds of links by what they may touch, this hand and "
            f"object have {len(classes)}: use engine mujoco or drake"
        )
    for geom, others in partners.items():
        touched = {classes[frozenset(partners[other])] for other in others}
        shape = shapes[geom]
        assert shape is not None
        shape.set_collision_groups([1 << classes[frozenset(others)], sum(1 << bit for bit in touched), 0, 0])
