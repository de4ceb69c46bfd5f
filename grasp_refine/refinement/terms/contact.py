"""Contact: links that should touch have no gap, and touch at their targets where they have any."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.se3 import Array, array_namespace, first_order_twist, matvec, transform_points
from grasp_refine.forces.contact_points import LinkPatches
from grasp_refine.refinement.solvers.rows import LinkRows
from grasp_refine.refinement.terms.motion import contact_curvatures, distance_covectors, target_misses, without_nan
from grasp_refine.refinement.terms.term import Setup, State, Term
from grasp_refine.witness.contact_kinematics import contact_slip_jacobian
from grasp_refine.witness.face_patch import NUM_CORNERS


class Contact(Term):
    """Gaps of the links that should touch, and misses of their targets, in metres."""

    def prepare(self, setup: Setup) -> None:
        """Find the links with a target, and links that should touch anywhere, in any of the grasps."""
        self.anywhere = setup.anywhere
        self.gap = setup.margin + setup.clearance
        self.aimed_columns, self.gap_columns = (
            np.flatnonzero(mask.any(axis=0)) for mask in (setup.goal.aimed, self.anywhere)
        )

    @staticmethod
    def applies(setup: Setup) -> bool:
        """Return whether any link should touch."""
        return bool((setup.goal.touching | setup.goal.aimed).any())

    def residuals(self, state: State) -> tuple[Array, ...]:
        """Return the gaps and misses (M, C, 7) of links with targets, and the gaps (M, L) of the others.

        Where flat faces meet, the gaps (M, S, 4) at the corners of their patches count as well: faces turn onto each
        other.
        """
        goal, w, T, member, found = self.setup.goal, state.witness, state.T_link, state.member, []
        if len(self.aimed_columns):
            on_link, on_object = goal.target_link[member], goal.target_object[member]
            if isinstance(T, np.ndarray):
                columns = self.aimed_columns
                w, T, on_link, on_object = w.pairs(columns), T[:, columns], on_link[:, columns], on_object[:, columns]
            found.append(
                contact_targets(w, T, state.T_object, state.like(on_link), state.like(on_object), self.setup.margin)
            )
        if len(self.gap_columns):
            found.append(contact_gap(state.witness, state.like(self.anywhere[member]), state.like(self.gap)))
        if state.patches is not None:
            found.append(self._corner_gaps(state, state.patches))
        return tuple(found)

    def rows(self, state: State, width: np.ndarray) -> Iterator[LinkRows]:
        """Return rows of gaps and tangential misses; misses along the normal have no derivative."""
        if len(self.aimed_columns):
            goal, columns = self.setup.goal, self.aimed_columns
            misses = target_misses(state, goal, columns)
            reach = np.stack([np.linalg.norm(miss, axis=-1) for miss in misses])
            needed = goal.aimed[state.member][:, columns]
            w, E, K_link, K_object = contact_curvatures(self.setup, state, columns, needed, reach, width)
            aimed = (needed & w.valid)[..., None]
            gap = np.where(aimed, w.distance[..., None] - self.setup.margin, 0.0)
            residual = [gap, *(matvec(E.mT, np.where(aimed, miss, 0.0)) for miss in misses)]
            covector = contact_targets_covectors(w, E, K_link, K_object)
            yield LinkRows.of(np.concatenate(residual, axis=-1), np.where(aimed[..., None], covector, 0.0), columns)
        if len(self.gap_columns):
            columns = self.gap_columns
            w = state.witness.pairs(columns)
            touching = self.anywhere[state.member][:, columns] & w.valid
            covector = np.where(touching[..., None], distance_covectors(w), 0.0)
            gap = contact_gap(w, touching, self.gap[columns])
            yield LinkRows.of(gap[..., None], covector[..., None, :], columns)
        if state.patches is not None and (number := int(state.patches.faces.count.any(axis=0).sum())):
            # Slots are filled in order.
            patches = state.patches.first(number)
            faces, shape = patches.faces, (len(state.member), -1)
            covector = self._corner_weights(patches)[..., None] * faces.slope
            link = np.repeat(np.maximum(patches.link, 0), NUM_CORNERS, axis=1)
            yield LinkRows(self._corner_gaps(state, patches).reshape(shape), covector.reshape(*shape, 6), link)

    def _corner_gaps(self, state: State, patches: LinkPatches) -> Array:
        """Return the gaps (M, S, 4) at the corners of patches, which count together as much as that of a link."""
        link, weight = np.maximum(patches.link, 0), self._corner_weights(patches)
        wanted = np.broadcast_to(self.gap, (self.anywhere.shape[1],))[link]
        gap = state.like(weight * (patches.faces.gap - wanted[..., None]))
        if isinstance(gap, np.ndarray):
            return gap
        # Found without a graph; their derivative in the twists of the links is known.
        T = state.T_link[np.arange(len(link))[:, None], link]
        return gap + matvec(state.like(weight[..., None] * patches.faces.slope), first_order_twist(T, T.detach()))

    @staticmethod
    def _corner_weights(patches: LinkPatches) -> np.ndarray:
        """Return the square roots (M, S, 4) of the weights of corners; they count as constants in derivatives."""
        faces = patches.faces
        each = np.sqrt(faces.weight / np.maximum(faces.count, 1))
        return np.where(faces.there, each[..., None], 0.0)


def contact_targets(
    witness: Witness,
    T_world_a: Array,
    T_world_b: Array | None,
    target_a: Array,
    target_b: Array,
    margin: float = 0.0,
) -> Array:
    """Return contact residuals (..., pair, 7) in metres: gap, and miss of the target on either body.

    r = [d - beta, x_a - t_a, x_b - t_b]. Its square is that of arXiv 2511.06267, Eq. 5, because
    |x_a - x_b + beta n|^2 = (d - beta)^2; written with the signed distance, the gap's gradient is exact and
    needs no smoothing. Zero where a pair has no target (NaN) or no witness points.

    Args:
        witness: Witness points of the contact pairs, world frame.
        T_world_a: Poses (..., pair, 4, 4) of the first bodies.
        T_world_b: Poses of the second bodies; None: the identity.
        target_a: Target points on body a (..., pair, 3), its own frame, metres.
        target_b: Target points on body b (..., pair, 3), its own frame, metres.
        margin: Contact margin beta in metres: the target signed distance.
    """
    xp = array_namespace(target_a)
    known = xp.asarray(witness.valid, device=target_a.device)
    aimed = ~(xp.any(xp.isnan(target_a), axis=-1) | xp.any(xp.isnan(target_b), axis=-1))
    on_b = without_nan(target_b)
    miss_a = witness.point_a - transform_points(T_world_a, without_nan(target_a))
    miss_b = witness.point_b - (on_b if T_world_b is None else transform_points(T_world_b, on_b))
    residual = xp.concat([(witness.distance - margin)[..., None], miss_a, miss_b], axis=-1)
    return xp.where((known & aimed)[..., None], residual, xp.zeros_like(residual))


def contact_targets_covectors(witness: Witness, E: Array, K_a: Array, K_b: Array) -> Array:
    """Return covectors (..., 5, 6) of the gap and of the tangential misses, [d, E^T (x_a - t_a), E^T (x_b - t_b)].

    The misses along the normal have none: seen from its body, a witness point moves along its surface.

    Args:
        witness: Witness points, world frame.
        E: Tangents (..., 3, 2) at the normals, as columns.
        K_a: Curvatures (..., 2, 2) of the links in that basis, 1/m.
        K_b: Curvatures of the object.
    """
    xp = array_namespace(E)
    U_a, U_b = contact_slip_jacobian(witness.point_b, witness.normal, witness.distance, E, K_a, K_b)
    return xp.concat([distance_covectors(witness)[..., None, :], -U_a, -U_b], axis=-2)


def contact_gap(witness: Witness, touching: Array, margin: Array | float = 0.0) -> Array:
    """Return d - beta (..., pair) in metres of links that should touch; zero for others and without witness points."""
    xp = array_namespace(witness.distance)
    wanted = xp.asarray(witness.valid, device=witness.distance.device) & touching
    return xp.where(wanted, witness.distance - margin, xp.zeros_like(witness.distance))
