"""Curvatures of both bodies at the witness points of many pairs, for contact kinematics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from grasp_refine.collision.engine import chosen
from grasp_refine.collision.query import Pairs, Witness
from grasp_refine.core.array_records import index_distinct
from grasp_refine.core.profiling import stage
from grasp_refine.core.se3 import matvec
from grasp_refine.geometry.body import Body
from grasp_refine.witness.analytical import feature_slip
from grasp_refine.witness.curvature import Curvatures, raise_eigenvalues, smallest_radii
from grasp_refine.witness.size import length_factor

if TYPE_CHECKING:
    from grasp_refine.witness.native_kinematics import NativePairs

SMALLEST_CURVATURE = 1.0
"""Floor of the summed curvatures of two bodies, divided by the mean of their extents."""

CORNER_CURVATURE_PER_M = 1e4
"""Curvature in 1/m used across an edge or at a vertex, where the exact one is infinite.

For pairs of bodies smaller than 1 cm, or larger than 1 m, it is scaled in proportion (`size.length_factor`).
"""

FEATURE_TOLERANCE = 1e-6
"""Largest distance of the witness from the plane of an active face, as a fraction of the piece's size."""


def pair_curvatures(pairs: Pairs, smallest: float) -> PairCurvatures:
    """Return the curvatures of pairs, with the floor `smallest`, prepared once."""
    name = f"curvatures {smallest}"
    if name not in pairs.derived:
        pairs.derived[name] = PairCurvatures.of(pairs, smallest)
    return pairs.derived[name]


@dataclass(frozen=True, eq=False)
class PairCurvatures:
    """Curvatures of the two bodies of P pairs at their witness points."""

    pairs: Pairs
    """The body pairs."""
    bodies: tuple[Body, ...]
    """The distinct bodies."""
    body: np.ndarray
    """Indices into them of the first bodies, then the second ones (2 P,)."""
    smallest_radius: np.ndarray
    """Smallest radii (2, P) of neighbourhoods on the first bodies, and on the second ones, in metres."""
    floor: np.ndarray
    """Floor (P,) of the eigenvalues of K_a + K_b, in 1/m."""
    corner: np.ndarray
    """Curvature used for edges and vertices (P,), in 1/m."""

    @staticmethod
    @stage("loading")
    def of(pairs: Pairs, smallest: float) -> PairCurvatures:
        """Prepare pairs; `smallest` is the floor of K_a + K_b, divided by the mean of the two bodies' extents."""
        both = (*pairs.a, *pairs.b)
        distinct, body = index_distinct(both)
        extent = np.array([one.extent for one in both]).reshape(2, -1)
        return PairCurvatures(
            pairs,
            tuple(distinct),
            body,
            smallest_radii(distinct)[body].reshape(2, -1),
            smallest / extent.mean(axis=0),
            CORNER_CURVATURE_PER_M / length_factor(pairs.a, pairs.b),
        )

    def fit(
        self,
        pair: np.ndarray,
        T_world_a: np.ndarray,
        T_world_b: np.ndarray,
        witness: Witness,
        E: np.ndarray,
        miss: np.ndarray,
        width: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fit K_a and K_b (M, 2, 2) of M items in 1/m, in their tangent bases.

        The neighbourhood of a witness has the radius 2 width |t - x|, or at least `smallest_radius`; with a width of 0
        there is none, and the curvatures belong to the exact face, edge or vertex, rounded or not.

        Args:
            pair: Body pair (M,) of each item.
            T_world_a: Poses of the first bodies (M, 4, 4).
            T_world_b: Poses of the second bodies.
            witness: Witness points (M,).
            E: Tangents (M, 3, 2), world frame.
            miss: Distances |t - x| (2, M) of the witness points from their targets on a, then on b, in metres.
            width: Factors (M,) of the radii.
        """
        radius = np.where(width > 0, np.maximum(2.0 * width * miss, self.smallest_radius[:, pair]), 0.0)
        return self.fit_within(pair, T_world_a, T_world_b, witness, E, radius)

    def fit_within(
        self,
        pair: np.ndarray,
        T_world_a: np.ndarray,
        T_world_b: np.ndarray,
        witness: Witness,
        E: np.ndarray,
        radius: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fit K_a and K_b (M, 2, 2) with given radii (2, M) in metres of neighbourhoods on a, then on b.

        The other arguments are as in `fit`. A radius of 0 stands for the exact feature.
        """
        if self.compiled is not None:
            return self.compiled.fit(pair, T_world_a, T_world_b, witness, E, radius)
        count = len(pair)
        T = np.concatenate([T_world_a, T_world_b])
        R = T[:, :3, :3].mT
        x = matvec(R, np.concatenate([witness.point_a, witness.point_b]) - T[:, :3, 3])
        normal = matvec(R, np.concatenate([witness.normal, -witness.normal]))
        E = R @ np.concatenate([E, E])
        rho = radius.reshape(-1)
        K = np.empty((2 * count, 2, 2))
        fitted, exact = np.flatnonzero(rho > 0), np.flatnonzero(~(rho > 0))
        body = np.concatenate([self.body[pair], self.body[pair + len(self.pairs)]])
        K[fitted] = self._curvatures.fit(body[fitted], x[fitted], normal[fitted], E[fitted], rho[fitted])
        if len(exact):
            corner = np.tile(self.corner[pair], 2)
            K[exact] = self._of_features(exact, x, normal, E, witness, corner)
        return raise_eigenvalues(K[:count], K[count:], self.floor[pair])

    @cached_property
    @stage("loading")
    def compiled(self) -> NativePairs | None:
        """The pairs in the compiled engine, where it is the one in use."""
        if chosen(self.pairs.engine) == "python":
            return None
        from grasp_refine.witness.native_kinematics import NativeCurvatures, NativePairs

        bodies = NativeCurvatures.of(self.bodies)
        return NativePairs(bodies, self.body, self.pairs.first_piece_pair, self.floor, self.corner)

    @cached_property
    @stage("loading")
    def _curvatures(self) -> Curvatures:
        return Curvatures.of(self.bodies)

    def _of_features(
        self,
        rows: np.ndarray,
        x: np.ndarray,
        normal: np.ndarray,
        E: np.ndarray,
        witness: Witness,
        corner: np.ndarray,
    ) -> np.ndarray:
        """Curvatures (R, 2, 2) of the faces, edges and vertices at some rows of both bodies' witness points."""
        count = len(witness.winner)
        item, second = rows % count, rows >= count
        winner = witness.winner[item]
        K = np.zeros((len(rows), 2, 2))
        for side, pieces in zip((~second, second), self.pairs.piece_pairs, strict=True):
            for number in np.unique(winner[side & (winner >= 0)]):
                here = np.flatnonzero(side & (winner == number))
                at, radius = rows[here], pieces[number].radius
                # At infinite distance, slip is 1 along the feature and 0 across, also where the piece is round.
                slip = feature_slip(pieces[number], x[at], normal[at], np.full(len(at), np.inf), FEATURE_TOLERANCE)
                across = np.eye(2) - E[at].mT @ slip @ E[at]
                sharp = np.full(len(at), 1.0 / radius) if radius > 0 else corner[at]
                K[here] = sharp[:, None, None] * across
        return K
