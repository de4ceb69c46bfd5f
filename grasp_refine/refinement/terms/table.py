"""Table: no link is below it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from grasp_refine.core.se3 import Array, array_namespace, cross, transform_points
from grasp_refine.geometry.body import Body
from grasp_refine.refinement.solvers.rows import LinkRows
from grasp_refine.refinement.terms.term import Setup, State, Term
from grasp_refine.scene.plane import Plane


@dataclass(frozen=True, eq=False)
class Table(Term):
    """Depths of the links below the table, in metres."""

    plane: Plane
    bodies: tuple[Body, ...]

    @classmethod
    def of(cls, setup: Setup) -> Table | None:
        """Return the term of a refinement; None without a table."""
        plane = setup.scene.table
        return None if plane is None else cls(plane, setup.prepared.pairs.a)

    def residuals(self, state: State) -> tuple[Array, ...]:
        """Return the depths max(0, offset - n . p) (M, L) of the lowest points of the links."""
        T = state.T_link if isinstance(state.T_link, np.ndarray) else state.T_link.detach().double().cpu().numpy()
        points = transform_points(state.T_link, state.like(self.plane.lowest(self.bodies, T)))
        depth = plane_depth(points, state.like(np.asarray(self.plane.normal)), self.plane.offset)
        xp = array_namespace(depth)
        return (xp.maximum(depth, xp.zeros_like(depth)),)

    def rows(self, state: State, width: np.ndarray) -> Iterator[LinkRows]:
        """Return rows of the links that are below the table or near it."""
        normal, points = np.asarray(self.plane.normal), self.plane.lowest(self.bodies, state.T_link)
        points = transform_points(state.T_link, points)
        yield LinkRows.near(plane_depth(points, normal, self.plane.offset), plane_covectors(points, normal))


def plane_depth(points: Array, normal: Array, offset: float) -> Array:
    """Return depths offset - n . p (...) in metres of points (..., 3) below a plane; negative above."""
    return offset - array_namespace(points).sum(points * normal, axis=-1)


def plane_covectors(points: Array, normal: Array) -> Array:
    """Return covectors -(n, p x n) (..., 6) of `plane_depth` on the twists of the bodies of the points."""
    xp = array_namespace(points)
    spread = normal + xp.zeros_like(points)
    return -xp.concat([spread, cross(points, spread)], axis=-1)
