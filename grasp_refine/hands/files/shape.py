"""Geometry of links as a hand's file describes it: primitives, points whose hull counts, surfaces, and mesh files."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from grasp_refine.core.array_types import Float, Int
from grasp_refine.core.short_repr import brief
from grasp_refine.geometry.pieces import Piece, box, capsule, cylinder, ellipsoid, hull, sphere

if TYPE_CHECKING:
    import trimesh

Scale = tuple[float, float, float]
"""Factors along x, y and z; negative ones mirror."""


@dataclass(frozen=True)
class Primitive:
    """A convex shape of a few numbers; whether they are positive is checked when it becomes a piece."""

    kind: Literal["box", "sphere", "cylinder", "capsule", "ellipsoid"]
    """Kind of shape, centred at the origin; cylinders and capsules along z."""
    size: tuple[float, ...]
    """Metres: the three sides of a box, the three semi-axes of an ellipsoid, or the radius and, for cylinders and
    capsules, the length, without the round ends of a capsule."""

    def piece(self) -> Piece:
        """Return the shape as a convex piece.

        Raises:
            MeshError: a size is not positive.
        """
        if self.kind == "box":
            return box(self.size)
        if self.kind == "ellipsoid":
            return ellipsoid(self.size)
        if self.kind == "sphere":
            return sphere(self.size[0])
        radius, length = self.size
        if self.kind == "cylinder":
            return cylinder(radius, length)
        return capsule(radius, (0.0, 0.0, -length / 2), (0.0, 0.0, length / 2))


@dataclass(frozen=True, eq=False)
class Hull:
    """The convex hull of points."""

    points: Float[np.ndarray, "k 3"]
    """Points (k, 3) in metres."""
    name: str
    """Name, for messages."""

    __repr__ = brief

    def piece(self) -> Piece:
        """Return the hull as a convex piece.

        Raises:
            MeshError: it has no thickness.
        """
        return hull(self.points, name=self.name)


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh, for display; it may be open."""

    vertices: Float[np.ndarray, "k 3"]
    """Vertices (k, 3) in metres."""
    faces: Int[np.ndarray, "f 3"]
    """Triangles (f, 3)."""

    __repr__ = brief

    def mesh(self) -> trimesh.Trimesh:
        """Return it as a mesh."""
        import trimesh

        return trimesh.Trimesh(self.vertices, self.faces, process=False)


@dataclass(frozen=True)
class MeshFile:
    """A mesh in a file of its own."""

    filename: str
    """Its address in the file of the hand."""
    scale: Scale = (1.0, 1.0, 1.0)
    """Factors of its coordinates."""


Geometry = Primitive | Hull | Surface | MeshFile
"""Geometry of a shape."""


@dataclass(frozen=True, eq=False)
class Shape:
    """Geometry at its place in a link."""

    geometry: Geometry
    """The geometry."""
    T_link_shape: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    """Pose (4, 4) of its frame in the frame of the link."""
    color: tuple[float, float, float] | None = None
    """Red, green and blue in [0, 1]; None where the file gives none."""

    __repr__ = brief
