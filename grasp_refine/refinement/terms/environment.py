"""Environment: no link is in a body around the object, or nearer to it than the body's margin."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.se3 import Array, array_namespace, inverse, transform_points
from grasp_refine.refinement.solvers.rows import NEAR_DISTANCE_M, LinkRows
from grasp_refine.refinement.terms.penetration import depth_rows, depths
from grasp_refine.refinement.terms.term import Setup, State, Term
from grasp_refine.scene.surroundings import Nearby, Surroundings


class Clearance(Term):
    """Depths of links in the margins of the bodies around the object, in metres."""

    cost: ClassVar[int] = 3

    @staticmethod
    def applies(setup: Setup) -> bool:
        """Return whether there are bodies that a grasp could reach."""
        return setup.surroundings is not None

    def complete(self, state: State, rejected: np.ndarray, self_witness: Callable[[np.ndarray], Witness]) -> State:
        """Return the state with its near bodies, given the near bodies of a nearby state."""
        T = state.T_link if isinstance(state.T_link, np.ndarray) else state.T_link.detach().double().cpu().numpy()
        return replace(state, nearby=self._surroundings.near(T, NEAR_DISTANCE_M, state.nearby, rejected))

    def residuals(self, state: State) -> tuple[Array, ...]:
        """Return the depths (M, K)."""
        nearby = self._nearby(state)
        margin = np.where(nearby.column >= 0, self._surroundings.margin[nearby.column], 0.0)
        if isinstance(state.T_link, np.ndarray):
            return (depths(nearby.witness, margin),)
        # The distance along the normal between points that stay on link and body: its derivative is that of the
        # distance of the bodies, exactly.
        w, link = nearby.witness, self._surroundings.link[nearby.column]
        row = np.arange(len(link))[:, None]
        on_link = transform_points(inverse(nearby.T_link[row, link]), w.point_a)
        T = state.T_link[row, link]
        xp = array_namespace(T)
        gap = state.like(w.point_b) - transform_points(T, state.like(on_link))
        depth = state.like(margin) - xp.sum(state.like(w.normal) * gap, axis=-1)
        deep = xp.asarray(w.valid, device=depth.device) & (depth > 0)
        return (xp.where(deep, depth, xp.zeros_like(depth)),)

    def rows(self, state: State, width: np.ndarray) -> Iterator[LinkRows]:
        """Return rows of the pairs that are near each other."""
        nearby, of = self._nearby(state), self._surroundings
        yield depth_rows(nearby.witness, of.link[nearby.column], clearance=of.margin[nearby.column])

    @property
    def _surroundings(self) -> Surroundings:
        assert self.setup.surroundings is not None  # the term applies
        return self.setup.surroundings

    @staticmethod
    def _nearby(state: State) -> Nearby:
        assert state.nearby is not None  # `complete` has found it
        return state.nearby.near
