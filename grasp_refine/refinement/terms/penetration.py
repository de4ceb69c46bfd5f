"""Penetration: no link is in the object."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.se3 import Array, array_namespace
from grasp_refine.refinement.solvers.rows import LinkRows
from grasp_refine.refinement.terms.motion import distance_covectors
from grasp_refine.refinement.terms.term import State, Term


class Penetration(Term):
    """Depths of the links in the object, in metres."""

    def residuals(self, state: State) -> tuple[Array, ...]:
        """Return the depths (M, L)."""
        return (depths(state.witness),)

    def rows(self, state: State, width: np.ndarray) -> Iterator[LinkRows]:
        """Return rows of the links that are in the object or near it."""
        yield depth_rows(state.witness)


def depths(witness: Witness) -> Array:
    """Return the penetration depths max(0, -d) (..., pair) in metres; zero where a pair has no witness points."""
    xp = array_namespace(witness.distance)
    deep = xp.asarray(witness.valid, device=witness.distance.device) & (witness.distance < 0)
    return xp.where(deep, -witness.distance, xp.zeros_like(witness.distance))


def depth_rows(witness: Witness, link: np.ndarray | None = None, minus: np.ndarray | None = None) -> LinkRows:
    """Return rows of the depths of pairs (M, P) that are near.

    Args:
        witness: Witness points.
        link: Links (P,) that are the first bodies; None: 0 to P - 1.
        minus: Links that are the second bodies; None: these rest.
    """
    depth = np.where(witness.valid, -witness.distance, -np.inf)
    return LinkRows.near(depth, -distance_covectors(witness), link, minus)
