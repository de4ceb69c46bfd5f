"""Direction: contact normals match the wanted normals. The force that a link exerts points along its normal."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.se3 import Array, array_namespace, cross
from grasp_refine.refinement.solvers.rows import LinkRows
from grasp_refine.refinement.terms.motion import contact_curvatures, target_misses, without_nan
from grasp_refine.refinement.terms.term import Setup, State, Term
from grasp_refine.witness.contact_kinematics import contact_slip_jacobian


class Direction(Term):
    """Differences of contact normals and target normals; half their square is 1 - cosine."""

    @staticmethod
    def applies(setup: Setup) -> bool:
        """Return whether there are target normals."""
        return setup.goal.direction is not None

    def residuals(self, state: State) -> tuple[Array, ...]:
        """Return the differences (M, L, 3)."""
        return (normal_difference(state.witness, state.like(self._wanted(state))),)

    def rows(self, state: State, width: np.ndarray) -> Iterator[LinkRows]:
        """Return rows of the normals of links with target normals."""
        wanted = self._wanted(state)
        columns = np.flatnonzero(~np.isnan(wanted[..., 0]).all(axis=0))
        difference = normal_difference(state.witness.pairs(columns), wanted[:, columns])
        needed = (difference != 0).any(axis=-1)
        reach = np.stack([np.linalg.norm(miss, axis=-1) for miss in target_misses(state, self.setup.goal, columns)])
        covector = normal_covectors(*contact_curvatures(self.setup, state, columns, needed, reach, width))
        yield LinkRows.of(difference, np.where(needed[..., None, None], covector, 0.0), columns)

    def _wanted(self, state: State) -> np.ndarray:
        """Return the target unit normals (M, L, 3) from link to object, world frame; NaN: any."""
        assert self.setup.goal.direction is not None  # the term applies
        return self.setup.goal.direction[state.member]


def normal_difference(witness: Witness, wanted: Array) -> Array:
    """Return n - n_target (..., pair, 3) of the contact normals, from link to object; zero without a target (NaN).

    Args:
        witness: Witness points, world frame.
        wanted: Target unit normals (..., pair, 3), world frame.
    """
    xp = array_namespace(wanted)
    known = xp.asarray(witness.valid, device=wanted.device) & ~xp.any(xp.isnan(wanted), axis=-1)
    difference = witness.normal - without_nan(wanted)
    return xp.where(known[..., None], difference, xp.zeros_like(difference))


def normal_covectors(witness: Witness, E: Array, K_a: Array, K_b: Array) -> Array:
    """Return covectors (..., 3, 6) of the contact normal: dn = w_a x n + E K_a u (see `contact_kinematics`)."""
    xp = array_namespace(E)
    U_a, _ = contact_slip_jacobian(witness.point_b, witness.normal, witness.distance, E, K_a, K_b)
    n = witness.normal
    # Rows of w -> w x n: e_i . (w x n) = w . (n x e_i).
    eye = xp.eye(3, dtype=n.dtype, device=n.device) + xp.zeros_like(n[..., None])
    turn = cross(n[..., None, :] + xp.zeros_like(eye), eye)
    return xp.concat([xp.zeros_like(turn), turn], axis=-1) - E @ (K_a @ U_a)
