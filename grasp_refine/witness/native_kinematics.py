"""Contact kinematics, compiled: `curvature`, `pair_curvature` and `contact_kinematics` in C++ (see `collision/native`).

The candidates of a body are sorted into blocks, and blocks beyond the radius are skipped. The results are the same for
any number of threads, and each depends on its own arguments only. The GIL is released.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Loads coal's library, which _native needs.
from grasp_refine.collision.native_search import threads_for
from grasp_refine.collision.query import Witness
from grasp_refine.geometry.body import Body
from grasp_refine.geometry.pieces import Piece

from grasp_refine.collision import _native  # type: ignore[attr-defined]  # compiled  # isort: skip

_FITS_PER_THREAD = 4096
"""Fewest fits for another thread: eight take as long as one item of a query."""


@dataclass(frozen=True, eq=False)
class NativeCurvatures:
    """Candidates and exact features of B bodies."""

    compiled: "_native.CurvedBodies"
    """The bodies in C++."""

    @staticmethod
    def of(bodies: Sequence[Body]) -> "NativeCurvatures":
        """Sort the candidates of bodies into blocks."""
        compiled = _native.CurvedBodies()
        for body in bodies:
            candidates, features = body.candidates, [_features(piece) for piece in body.pieces]
            compiled.add(candidates.points, candidates.normals, body.area, features)
        return NativeCurvatures(compiled)

    def fit(self, body: np.ndarray, x: np.ndarray, normal: np.ndarray, E: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """Return the curvatures (R, 2, 2) of `Curvatures.fit`."""
        K = np.empty((len(x), 2, 2))
        self.compiled.fit(body, x, normal, E, radius, K, threads_for(len(x), _FITS_PER_THREAD))
        return K


class NativePairs:
    """Curvatures of P body pairs."""

    def __init__(
        self,
        bodies: NativeCurvatures,
        body: np.ndarray,
        first_piece_pair: np.ndarray,
        floor: np.ndarray,
        corner: np.ndarray,
    ) -> None:
        """Prepare the pairs; the arguments are fields of a `PairCurvatures` and its `Pairs`."""
        self._compiled = _native.CurvaturePairs(bodies.compiled, body, first_piece_pair, floor, corner)

    def fit(
        self,
        pair: np.ndarray,
        T_world_a: np.ndarray,
        T_world_b: np.ndarray,
        witness: Witness,
        E: np.ndarray,
        radius: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the curvatures K_a and K_b (M, 2, 2) of `PairCurvatures.fit_within`."""
        w, count = witness, len(pair)
        K_a, K_b = np.empty((2, count, 2, 2))
        threads = threads_for(count, _FITS_PER_THREAD)
        self._compiled.fit(
            pair, T_world_a, T_world_b, w.point_a, w.point_b, w.normal, E, radius, w.winner, K_a, K_b, threads
        )
        return K_a, K_b

    def pose_gradients(
        self,
        T_world_a: np.ndarray,
        T_world_b: np.ndarray,
        witness: Witness,
        radius: np.ndarray,
        cotangents: Sequence[np.ndarray | None],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradients (batch, P, 4, 4) of `ContactKinematics.pose_gradients`; radii are (2 P, batch or 1)."""
        w = witness
        G_a, G_b = np.empty(T_world_a.shape), np.empty(T_world_b.shape)
        threads = threads_for(w.distance.size, _FITS_PER_THREAD)
        self._compiled.pose_gradients(
            T_world_a, T_world_b, w.point_a, w.point_b, w.normal, w.distance, w.status, w.winner, radius,
            *cotangents, G_a, G_b, threads,
        )  # fmt: skip
        return G_a, G_b


def pull_back(
    witness: Witness,
    E: np.ndarray,
    curvatures: tuple[np.ndarray, np.ndarray],
    forces: tuple[np.ndarray, np.ndarray, np.ndarray | None],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the wrenches (..., 6) on both bodies of `ContactKinematics.pull_back`.

    Args:
        witness: Witness points (...).
        E: Tangents (..., 3, 2).
        curvatures: K_a and K_b (..., 2, 2).
        forces: Covectors (..., 3) on both points, and on the normal, or None.
    """
    w = witness
    wrench_a, wrench_b = np.empty((2, *w.distance.shape, 6))
    _native.pull_back(
        w.point_a, w.point_b, w.normal, w.distance, E, *curvatures, *forces, wrench_a=wrench_a, wrench_b=wrench_b
    )
    return wrench_a, wrench_b


def slip_jacobians(*arrays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the Jacobians U_a and U_b (..., 2, 6) of `contact_slip_jacobian`, which has the same arguments."""
    normal = arrays[1]
    U_a, U_b = np.empty((2, *normal.shape[:-1], 2, 6))
    _native.slip_jacobians(*arrays, U_a, U_b)
    return U_a, U_b


def _features(piece: Piece) -> "_native.Features":
    """Faces, edges and vertices of a piece, built once."""
    if "features" not in piece.derived:
        planes = piece.planes if len(piece.vertices) > 2 else (np.zeros((0, 3)), np.zeros(0))
        arrays = (np.ascontiguousarray(array, dtype=np.float64) for array in (piece.vertices, *planes))
        piece.derived["features"] = _native.Features(*arrays, piece.radius)
    return piece.derived["features"]
