"""Collision geometry of a MuJoCo model in Drake, its material, and the pairs of geoms that can touch."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
from pydrake.geometry import (
    Box,
    Capsule,
    CollisionFilterDeclaration,
    Convex,
    Cylinder,
    Ellipsoid,
    GeometryId,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.multibody.plant import CoulombFriction

from grasp_refine.core.errors import GraspRefineError
from grasp_refine.validation.engines.geom_points import geom_points

CONTACT_STIFFNESS_N_M = 5e4
"""Stiffness of a contact of two bodies in N/m: a fingertip that presses with 5 N sinks in by 0.1 mm, as in MuJoCo."""

CONTACT_DISSIPATION_S_M = 10.0
"""Dissipation of Hunt and Crossley, in s/m, of a contact."""


def material(friction: float, contact_time: float) -> ProximityProperties:
    """Return the material of all geometry: sliding friction, and stiffness divided by the square of `contact_time`."""
    properties = ProximityProperties()
    # Two springs in series.
    stiffness = 2 * CONTACT_STIFFNESS_N_M / contact_time**2
    properties.AddProperty("material", "coulomb_friction", CoulombFriction(friction, friction))
    properties.AddProperty("material", "point_contact_stiffness", stiffness)
    properties.AddProperty("material", "hunt_crossley_dissipation", CONTACT_DISSIPATION_S_M)
    return properties


def shape_of(model: mujoco.MjModel, geom: int) -> Shape:
    """Return the shape of a geom in its own frame; of a mesh, the hull of its vertices, as MuJoCo collides it.

    Raises:
        GraspRefineError: a kind of geom that Drake has no counterpart of.
    """
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return Convex(points=geom_points(model, geom).T, label=model.geom(geom).name)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return Box(2 * size)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return Sphere(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return Capsule(size[0], 2 * size[1])
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return Cylinder(size[0], 2 * size[1])
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return Ellipsoid(*size)
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        return HalfSpace()
    raise GraspRefineError(f"engine drake has no geometry like geom '{model.geom(geom).name}' of MuJoCo: {kind.name}")


def let_collide(scene: SceneGraph, geoms: Mapping[int, GeometryId], pairs: list[tuple[int, int]]) -> None:
    """Let these pairs of geoms collide, and no others."""
    rule = CollisionFilterDeclaration().ExcludeWithin(GeometrySet(list(geoms.values())))
    for a, b in pairs:
        rule.AllowBetween(GeometrySet(geoms[a]), GeometrySet(geoms[b]))
    scene.collision_filter_manager().Apply(rule)
