"""Mass distribution of a link: as the URDF gives it, corrected where it is impossible, or from the link's geometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.short_repr import brief
from grasp_refine.geometry.pieces import Piece

DENSITY = 1000.0
"""Density in kg/m^3 of links whose file gives no mass."""

MOMENT_ROUNDING = 1e-6
"""Share of the largest moment by which moments may break the triangle inequality: rounding."""

MOMENT_MARGIN = 1e-9
"""Share of the largest moment by which balanced moments stay off the bound, so that rounding does not break it."""

MIN_MASS_KG = MIN_MOMENT_KG_M2 = 1e-15
"""Least mass in kg, and least principal moment in kg m^2, that MuJoCo accepts for a body that moves."""


@dataclass(frozen=True, eq=False)
class Inertia:
    """Mass, centre of mass and moments of inertia of a rigid body."""

    mass: float
    """Mass in kg."""
    centre: Float[np.ndarray, " 3"]
    """Centre of mass (3,) in metres, link frame."""
    matrix: Float[np.ndarray, "3 3"]
    """Moments (3, 3) in kg m^2 about that point, along the axes of the link frame."""

    __repr__ = brief

    @classmethod
    def about(cls, mass: float, T_link_inertial: np.ndarray, matrix: np.ndarray) -> Inertia:
        """Inertia with moments `matrix` (3, 3) about the origin and along the axes of `T_link_inertial` (4, 4)."""
        turn = np.asarray(T_link_inertial)[:3, :3]
        return cls(float(mass), np.array(T_link_inertial[:3, 3], dtype=float), turn @ np.asarray(matrix) @ turn.T)

    @classmethod
    def join(cls, parts: Sequence[Inertia]) -> Inertia:
        """Inertia of all parts as one body; they are in one frame, and the sum of their masses is above 0."""
        mass = sum(part.mass for part in parts)
        centre = sum((part.mass * part.centre for part in parts), np.zeros(3)) / mass
        return cls(mass, centre, sum((part.matrix + _offset(part.mass, part.centre - centre)) for part in parts))

    @classmethod
    def of(cls, pieces: Sequence[Piece], density: float = DENSITY) -> Inertia:
        """Inertia of solid pieces of one density in kg/m^3; where they overlap, mass counts twice."""
        return cls.join([_of_piece(piece, density) for piece in pieces])

    def principal(self) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]]:
        """Moments (3,) in ascending order, and a rotation (3, 3) whose columns are their axes."""
        moments, axes = np.linalg.eigh((self.matrix + self.matrix.T) / 2)
        return moments, axes * np.linalg.det(axes)

    def gyration_radius(self) -> float:
        """Return the largest radius of gyration in metres about an axis through the centre of mass.

        No mass distribution has one beyond its farthest point.
        """
        return float(np.sqrt(max(self.principal()[0][2], 0.0) / self.mass))

    def positive(self) -> bool:
        """Return True if the mass and all principal moments are as large as MuJoCo needs them."""
        return self.mass >= MIN_MASS_KG and bool(self.principal()[0][0] >= MIN_MOMENT_KG_M2)

    def possible(self) -> bool:
        """Return True if no principal moment exceeds the sum of the two others, as holds for any mass distribution."""
        moments, _ = self.principal()
        # Moments of thin bodies are at the bound, and were rounded when they were written.
        return bool(moments[2] - moments[0] - moments[1] <= MOMENT_ROUNDING * moments[2])

    def balanced(self) -> Inertia:
        """Return it with the two smaller moments raised equally to the bound, where it is impossible.

        Mass and moments are at least what MuJoCo needs.
        """
        moments, axes = self.principal()
        lack = moments[2] * (1 + MOMENT_MARGIN) - moments[0] - moments[1]
        moments = moments + max(lack, 0.0) / 2 * np.array([1, 1, 0])
        # A little more, since the product of axes and moments loses digits.
        moments = np.where(moments < MIN_MOMENT_KG_M2, 1.001 * MIN_MOMENT_KG_M2, moments)
        return Inertia(max(self.mass, MIN_MASS_KG), self.centre, axes @ np.diag(moments) @ axes.T)


def _of_piece(piece: Piece, density: float) -> Inertia:
    if len(piece.vertices) == 1:
        return _sphere(piece.vertices[0], piece.radius, density)
    if len(piece.vertices) == 2:
        return _capsule(piece, density)
    mesh = piece.mesh()
    # About the centre of its bounding box, so that far from the origin no digits are lost.
    middle = mesh.bounds.mean(axis=0)
    mesh.apply_translation(-middle)
    mesh.density = density
    return Inertia(float(mesh.mass), middle + mesh.center_mass, np.array(mesh.moment_inertia, dtype=float))


def _sphere(centre: np.ndarray, radius: float, density: float) -> Inertia:
    mass = density * 4 / 3 * np.pi * radius**3
    return Inertia(float(mass), np.array(centre, dtype=float), 0.4 * mass * radius**2 * np.eye(3))


def _capsule(piece: Piece, density: float) -> Inertia:
    """Inertia of a cylinder and two hemispheres, whose centres of mass are 3/8 r from their flat sides."""
    (a, b), r = piece.vertices, piece.radius
    length = float(np.linalg.norm(b - a))
    axis, middle = (b - a) / length, (a + b) / 2
    tube, caps = density * np.pi * r**2 * length, density * 4 / 3 * np.pi * r**3
    along = tube * r**2 / 2 + caps * 0.4 * r**2
    across = tube * (r**2 / 4 + length**2 / 12) + caps * (0.4 * r**2 + length**2 / 4 + 3 / 8 * r * length)
    onto = np.outer(axis, axis)
    return Inertia(float(tube + caps), middle, along * onto + across * (np.eye(3) - onto))


def _offset(mass: float, d: np.ndarray) -> np.ndarray:
    """Moments (3, 3) of a point mass at `d` (3,), by the parallel axis theorem."""
    return mass * (d @ d * np.eye(3) - np.outer(d, d))
