"""Region: links touch the object where hands may touch it, and keep away from it elsewhere."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.se3 import Array, array_namespace, matvec
from grasp_refine.forces.squeeze import CONTACTS
from grasp_refine.refinement.solvers.rows import LinkRows
from grasp_refine.refinement.terms.motion import contact_curvatures, distance_covectors
from grasp_refine.refinement.terms.term import Setup, State, Term
from grasp_refine.witness.contact_kinematics import contact_slip_jacobian

INSIDE_M = 3e-3
"""Distance in metres from the border of the regions at which contacts are inside: about the reach of the patch of a
fingertip; this term moves one point of it."""


class InRegion(Term):
    """Distances in metres of contacts from where hands may touch, and of other links from where they may not.

    A link that should touch costs the distance m of its witness point on the object from the regions, which is made
    `INSIDE_M` larger. Any other link would be a contact there within its `reach`: it costs min(m, reach - d) at a
    distance d, so that it keeps away, or slides inside. Links with targets are left alone.
    """

    def prepare(self, setup: Setup) -> None:
        """Find the reach of each link, and the first column of each."""
        links = setup.scene.links
        self.reach = CONTACTS.cutoff(setup.scene.hand, links)
        self.first = np.array([links.index(link) == column for column, link in enumerate(links)])

    @staticmethod
    def applies(setup: Setup) -> bool:
        """Return whether there are regions."""
        return setup.scene.regions is not None

    def residuals(self, state: State) -> tuple[Array, ...]:
        """Return the distances (M, L)."""
        witness = state.witness
        w = witness.detached()
        miss, gradient, keeps = self._misses(state.member, w)
        value = np.maximum(np.where(keeps, self.reach - w.distance, miss), 0.0)
        if isinstance(witness.distance, np.ndarray):
            return (value,)
        # Regions are evaluated without a graph; their gradients follow the points.
        xp = array_namespace(witness.distance)
        slid = xp.sum(state.like(gradient) * (witness.point_b - state.like(w.point_b)), axis=-1)
        moved = xp.where(state.like(keeps), state.like(w.distance) - witness.distance, slid)
        return (state.like(value) + xp.where(state.like(value > 0.0), moved, xp.zeros_like(moved)),)

    def rows(self, state: State, width: np.ndarray) -> Iterator[LinkRows]:
        """Return rows of links near the border or outside: how contacts slide, and of others the distance."""
        w = state.witness
        miss, gradient, keeps = self._misses(state.member, w)
        covector, slides = -distance_covectors(w), ~keeps & np.isfinite(miss)
        columns = np.flatnonzero(slides.any(axis=0))
        if len(columns):
            radius = np.broadcast_to(np.maximum(miss[:, columns], 0.0), (2, len(miss), len(columns)))
            at, E, K_a, K_b = contact_curvatures(self.setup, state, columns, slides[:, columns], radius, width)
            _, U_b = contact_slip_jacobian(at.point_b, at.normal, at.distance, E, K_a, K_b)
            # The twist of the object relative to a link is minus that of the link.
            along = -matvec(U_b.mT, matvec(E.mT, gradient[:, columns]))
            covector[:, columns] = np.where(slides[:, columns, None], along, covector[:, columns])
        yield LinkRows.near(np.where(keeps, self.reach - w.distance, miss), covector)

    def _misses(self, member: np.ndarray, witness: Witness) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return distances (M, L) of witness points from the regions, gradients (M, L, 3), and a mask (M, L).

        Distances are -inf where they do not count. The mask is True for links that keep their distance from the object
        instead.
        """
        assert self.setup.scene.regions is not None  # the term applies
        touching, aimed = self.setup.anywhere[member], self.setup.goal.aimed[member]
        counts = witness.valid & ~aimed & (touching | (self.first & (witness.distance < self.reach)))
        miss, gradient = np.full(counts.shape, -np.inf), np.zeros((*counts.shape, 3))
        found, gradient[counts] = self.setup.scene.regions.signed_distance(witness.point_b[counts])
        miss[counts] = found + INSIDE_M
        return miss, gradient, counts & ~touching & (self.reach - witness.distance < miss)
