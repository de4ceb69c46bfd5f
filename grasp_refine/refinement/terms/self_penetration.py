"""Self-penetration: no link is in another."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.se3 import Array
from grasp_refine.refinement.solvers.rows import LinkRows
from grasp_refine.refinement.terms.penetration import depth_rows, depths
from grasp_refine.refinement.terms.term import Setup, State, Term


class SelfPenetration(Term):
    """Depths of links in each other, in metres."""

    cost: ClassVar[int] = 2

    @staticmethod
    def applies(setup: Setup) -> bool:
        """Return whether any links can touch each other."""
        return setup.prepared.self_collision_pairs is not None

    def complete(self, state: State, rejected: np.ndarray, self_witness: Callable[[np.ndarray], Witness]) -> State:
        """Return the state with the witness points of the pairs of links."""
        return replace(state, self_witness=self_witness(rejected))

    def residuals(self, state: State) -> tuple[Array, ...]:
        """Return the depths (M, S)."""
        return (depths(state.self_witness),)

    def rows(self, state: State, width: np.ndarray) -> Iterator[LinkRows]:
        """Return rows of the pairs of links that are near each other."""
        yield depth_rows(state.self_witness, *self.setup.prepared.self_collision_links)
