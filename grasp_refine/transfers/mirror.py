"""Mirror planes of objects, at which grasps of a right hand become grasps of a left one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.core.array_types import Bool, Float
from grasp_refine.objects.object import Object
from grasp_refine.transfers.nearest_surface import nearest_surface
from grasp_refine.transfers.source_grasps import SourceGrasps

TOLERANCE_M = 2e-3
"""Largest distance in metres of the mirrored surface from the surface."""


@dataclass(frozen=True, eq=False)
class MirrorPlane:
    """A plane."""

    point: Float[np.ndarray, " 3"]
    """Point (3,) on it, metres."""
    normal: Float[np.ndarray, " 3"]
    """Unit normal (3,)."""

    def points(self, points: Float[np.ndarray, "*N 3"]) -> Float[np.ndarray, "*N 3"]:
        """Return mirrored points (..., 3)."""
        return points - 2.0 * ((points - self.point) @ self.normal)[..., None] * self.normal

    def vectors(self, vectors: Float[np.ndarray, "*N 3"]) -> Float[np.ndarray, "*N 3"]:
        """Return mirrored vectors (..., 3)."""
        return vectors - 2.0 * (vectors @ self.normal)[..., None] * self.normal


def mirror_plane(obj: Object) -> MirrorPlane | None:
    """Return a plane at which an object is its own mirror image, within `TOLERANCE_M`; None: there is none.

    It goes through the centre of mass, and is normal to one of its principal axes or of the axes of its frame.
    """
    surface, center = obj.body.candidates, obj.center_of_mass
    principal = np.asarray(obj.mesh.principal_inertia_vectors, dtype=np.float64)
    best, plane = TOLERANCE_M, None
    for normal in (*np.eye(3), *principal):
        found = MirrorPlane(center, normal)
        off = np.abs(nearest_surface(obj, found.points(surface.points))[2]).max()
        # The first of several that are equally good, whatever the last bits are.
        if off < best - 1e-6:
            best, plane = float(off), found
    return plane


def mirrored(grasps: SourceGrasps, plane: MirrorPlane, rows: Bool[np.ndarray, " N"]) -> SourceGrasps:
    """Return grasps whose `rows` (N,) are mirrored: a right hand becomes a left one."""

    def chosen(mirror: np.ndarray, plain: np.ndarray) -> np.ndarray:
        return np.where(rows.reshape(-1, *(1,) * (plain.ndim - 1)), mirror, plain)

    return replace(
        grasps,
        point=chosen(plane.points(grasps.point), grasps.point),
        normal=chosen(plane.vectors(grasps.normal), grasps.normal),
        center=chosen(plane.points(grasps.center), grasps.center),
        axes=chosen(plane.vectors(grasps.axes.mT).mT, grasps.axes),
    )
