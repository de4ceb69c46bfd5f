"""Table: no link is below it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from grasp_refine.core.se3 import Array, array_namespace, cross, transform_points
from grasp_refine.refinement.solvers.rows import LinkRows
from grasp_refine.refinement.terms.term import Setup, State, Term
from grasp_refine.scene.hand_object import moving_links


class Table(Term):
    """Depths of the links below the table, in metres."""

    @staticmethod
    def applies(setup: Setup) -> bool:
        """Return whether there is a table."""
        return setup.scene.table is not None

    def residuals(self, state: State) -> tuple[Array, ...]:
        """Return the depths max(0, offset - n . p) (M, L) of the lowest points of the links."""
        depth = self._only_moving(plane_depth(*self._lowest(state)))
        xp = array_namespace(depth)
        return (xp.maximum(depth, xp.zeros_like(depth)),)

    def rows(self, state: State, width: np.ndarray) -> Iterator[LinkRows]:
        """Return rows of the links that are below the table or near it."""
        points, normal, offset = self._lowest(state)
        yield LinkRows.near(self._only_moving(plane_depth(points, normal, offset)), plane_covectors(points, normal))

    def _only_moving(self, depth: Array) -> Array:
        """Return depths (M, L), -inf for links that stand on the table with an arm's base."""
        moving = moving_links(self.setup.scene.hand, self.setup.scene.links)
        return depth if moving is None else np.where(moving, depth, -np.inf)

    def _lowest(self, state: State) -> tuple[Array, Array, float]:
        """Return the lowest points of the links (M, L, 3), world frame, and the plane."""
        plane, T = self.setup.scene.table, state.T_link
        assert plane is not None  # the term applies
        array = T if isinstance(T, np.ndarray) else T.detach().double().cpu().numpy()
        # Each link is there once for each object.
        links = self.setup.prepared.pairs.a[: array.shape[1]]
        points = transform_points(T, state.like(plane.lowest(links, array)))
        return points, state.like(np.asarray(plane.normal)), plane.offset


def plane_depth(points: Array, normal: Array, offset: float) -> Array:
    """Return depths offset - n . p (...) in metres of points (..., 3) below a plane; negative above."""
    return offset - array_namespace(points).sum(points * normal, axis=-1)


def plane_covectors(points: Array, normal: Array) -> Array:
    """Return covectors -(n, p x n) (..., 6) of `plane_depth` on the twists of the bodies of the points."""
    xp = array_namespace(points)
    spread = normal + xp.zeros_like(points)
    return -xp.concat([spread, cross(points, spread)], axis=-1)
