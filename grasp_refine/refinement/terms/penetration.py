"""Penetration: no link is in the object."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.se3 import Array, array_namespace
from grasp_refine.refinement.solvers.rows import LinkRows
from grasp_refine.refinement.terms.motion import distance_covectors
from grasp_refine.refinement.terms.term import Setup, State, Term


class Penetration(Term):
    """Depths of the links in the object, or in their clearance about it, in metres."""

    def prepare(self, setup: Setup) -> None:
        """Make the term with the clearance of each link."""
        self.clearance = np.where(setup.goal.aimed, 0.0, setup.clearance)

    def residuals(self, state: State) -> tuple[Array, ...]:
        """Return the depths (M, L)."""
        return (depths(state.witness, state.like(self.clearance[state.member])),)

    def rows(self, state: State, width: np.ndarray) -> Iterator[LinkRows]:
        """Return rows of the links that are in the object or near it."""
        yield depth_rows(state.witness, clearance=self.clearance[state.member])


def depths(witness: Witness, clearance: Array | float = 0.0) -> Array:
    """Return the depths max(0, clearance - d) (..., pair) in metres; zero where a pair has no witness points."""
    xp = array_namespace(witness.distance)
    depth = clearance - witness.distance
    deep = xp.asarray(witness.valid, device=depth.device) & (depth > 0)
    return xp.where(deep, depth, xp.zeros_like(depth))


def depth_rows(
    witness: Witness,
    link: np.ndarray | None = None,
    minus: np.ndarray | None = None,
    clearance: np.ndarray | float = 0.0,
) -> LinkRows:
    """Return rows of the depths of pairs (M, P) that are near.

    Args:
        witness: Witness points.
        link: Links (P,) or (M, P) that are the first bodies; None: 0 to P - 1.
        minus: Links that are the second bodies; None: these rest.
        clearance: As for `depths`.
    """
    depth = np.where(witness.valid, clearance - witness.distance, -np.inf)
    return LinkRows.near(depth, -distance_covectors(witness), link, minus)
