"""Algebra shared by all slip methods: the motion of witness points of two moving bodies.

Body a at rest, a point y outside it: its closest point is x_a = f(y), with slip matrix A = df/dy (3x3, world
frame). For a moving rigidly with the velocity field V_a, equivariance gives the rest:

    dx_a = V_a(x_a) + A (dx_b - V_a(x_b)),        dx_b = V_b(x_b) + B (dx_a - V_b(x_a)).

"coupled" solves the two equations together. "one-sided" is arXiv 2511.06267: the other witness point of each
self term is held fixed, dx_a = V_a(x_a) - A V_a(x_b) + A [V_b(x_b) - B V_b(x_a)]; it needs no inverse and is
*not* invariant when both bodies move together.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np

from grasp_refine.core.se3 import cross, matvec
from grasp_refine.witness.scene import Sides, WitnessScene

Coupling = Literal["coupled", "one-sided"]

_MAX_SLIP = 1.0 - 1e-6
"""Largest slip, just below 1: a closest point never moves farther than the point it follows (projection onto a convex
set)."""


_MIN_SINGULAR_VALUE = 1e-11
"""Singular value of I - A B below which it is rounding: two round surfaces give (gap / radius), which is more.

So the largest derivative is 1e11 for exact slips, 5e5 for clipped ones.
"""


@dataclass(frozen=True, eq=False)
class Slip:
    """Slip matrices of a batch of witness pairs."""

    A: np.ndarray
    """dx_a / dx_b with body a at rest (..., 3, 3), world frame."""
    B: np.ndarray
    """dx_b / dx_a with body b at rest (..., 3, 3), world frame."""
    self_a: np.ndarray
    """Point (..., 3) that moves rigidly with body a in its self term: x_a, or the smoothed point x_a*."""
    self_b: np.ndarray
    """Point (..., 3) that moves rigidly with body b in its self term."""
    sampled: bool = True
    """Whether A and B are estimates: the coupled solve then clips their eigenvalues to [0, 1)."""

    @staticmethod
    def of_sides(scene: WitnessScene, sides: Sides, local: np.ndarray, *, sampled: bool = True) -> "Slip":
        """Return the slip of a scene from matrices (S, batch, 3, 3) in the body frames; witness points move rigidly."""
        world = (sides.rotation @ local @ sides.rotation.mT).swapaxes(0, 1)
        pairs = scene.T_world_a.shape[1]
        return Slip(world[:, :pairs], world[:, pairs:], scene.witness.point_a, scene.witness.point_b, sampled)


class SlipMethod(ABC):
    """A derivative method that gives only the slip matrices."""

    coupling: Coupling
    """Solve both slips together, or hold the other witness point fixed."""

    @abstractmethod
    def slip(self, scene: WitnessScene) -> Slip:
        """Slip matrices (batch, pair, 3, 3) of both bodies, world frame."""

    def pull_back(
        self, scene: WitnessScene, force_a: np.ndarray, force_b: np.ndarray, force_n: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Wrenches (batch, pair, 6) on the two bodies from covectors on witness points and normal."""
        return pull_back_witness(self.slip(scene), scene, force_a, force_b, force_n, self.coupling)


def pull_back(
    slip: Slip,
    point_a: np.ndarray,
    point_b: np.ndarray,
    force_a: np.ndarray,
    force_b: np.ndarray,
    coupling: Coupling = "coupled",
) -> tuple[np.ndarray, np.ndarray]:
    """Wrenches (..., 6) on the two bodies from covectors on the witness points: the transpose of their motion.

    Args:
        slip: Slip matrices.
        point_a: Witness points (..., 3), world frame.
        point_b: Witness points (..., 3) on body b, world frame.
        force_a: dL/dx_a (..., 3).
        force_b: dL/dx_b (..., 3).
        coupling: Solve both slips together, or hold the other witness point fixed.

    Returns:
        Covectors (f, m) on the spatial twists of body a and body b: dL = f . v + m . w.
    """
    A, B = _slip_matrices(slip, coupling)
    A_transposed, B_transposed = A.mT, B.mT
    if coupling == "one-sided":
        lambda_a = force_a + matvec(B_transposed, force_b)
        lambda_b = force_b + matvec(A_transposed, force_a)
    else:
        right = force_a + matvec(B_transposed, force_b)
        lambda_a = _solve(np.eye(3) - B_transposed @ A_transposed, right, exact=not slip.sampled)
        lambda_b = force_b + matvec(A_transposed, lambda_a)
    # About a witness point: these forces may be large and cancel, as do their moments about a distant origin.
    points = np.stack([slip.self_a, slip.self_b, point_b, point_a]) - point_a
    forces = np.stack([lambda_a, lambda_b, -matvec(A_transposed, lambda_a), -matvec(B_transposed, lambda_b)])
    wrenches = wrench(points, forces)
    both = wrenches[:2] + wrenches[2:]
    if share := _common_share(slip, coupling):
        total = wrench(points[3], force_a) + wrench(points[2], force_b)
        both = both + share * (total - both[0] - both[1])
    force = both[..., :3]
    both = np.concatenate([force, both[..., 3:] + cross(point_a + np.zeros_like(force), force)], axis=-1)
    return both[0], both[1]


def pull_back_witness(
    slip: Slip,
    scene: WitnessScene,
    force_a: np.ndarray,
    force_b: np.ndarray,
    force_n: np.ndarray | None,
    coupling: Coupling,
) -> tuple[np.ndarray, np.ndarray]:
    """Wrenches on the two bodies from covectors on witness points and normal; arguments as in `pull_back`.

    The normal follows the points' difference, dn = P (dx_b - dx_a) / d, where they are apart by more than the
    candidate spacing h; towards contact that becomes undefined and is blended, with weight h^2 / (d^2 + h^2), into
    the mean rotation of the two bodies. Both parts are exact when the bodies move together.
    """
    w = scene.witness
    if force_n is None:
        return pull_back(slip, w.point_a, w.point_b, force_a, force_b, coupling)
    spacing = scene.surfaces.spacing.reshape(2, -1).mean(axis=0)
    d = w.distance
    per_metre = (d / (d * d + spacing**2))[..., None]
    tangential = force_n - (force_n * w.normal).sum(axis=-1, keepdims=True) * w.normal
    wrench_a, wrench_b = pull_back(
        slip,
        w.point_a,
        w.point_b,
        force_a - per_metre * tangential,
        force_b + per_metre * tangential,
        coupling,
    )
    moment = 0.5 * cross(w.normal, tangential) * (1.0 - per_metre * d[..., None])
    wrench_a[..., 3:] += moment
    wrench_b[..., 3:] += moment
    return wrench_a, wrench_b


def wrench(point: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Wrench (f, p x f) (..., 6) at the world origin of a force (..., 3) at a point (..., 3)."""
    return np.concatenate([force, cross(point, force)], axis=-1)


def contract(matrix: np.ndarray) -> np.ndarray:
    """Symmetric part of slip matrices (..., 3, 3) with eigenvalues clipped to [0, 1 - 1e-6].

    A sampled covariance can have eigenvalues above 1, for which I - A B would change sign.
    """
    M = 0.5 * (matrix + matrix.mT)
    bad = ~(_positive_definite(M, floor=-1e-9) & _positive_definite(-M, floor=-_MAX_SLIP))
    if bad.any():
        values, vectors = np.linalg.eigh(M[bad])
        M[bad] = (vectors * np.clip(values, 0.0, _MAX_SLIP)[..., None, :]) @ vectors.mT
    return M


def _positive_definite(M: np.ndarray, floor: float) -> np.ndarray:
    """Mask (...) of symmetric matrices (..., 3, 3) with all eigenvalues above `floor` (Sylvester's criterion)."""
    a, b, c = M[..., 0, 0] - floor, M[..., 1, 1] - floor, M[..., 2, 2] - floor
    d, e, f = M[..., 0, 1], M[..., 0, 2], M[..., 1, 2]
    minor = a * b - d * d
    determinant = c * minor - a * f * f - b * e * e + 2.0 * d * e * f
    return (a > 0) & (minor > 0) & (determinant > 0)


def _common_share(slip: Slip, coupling: Coupling) -> float:
    """Share of the sum of both twists that points follow rigidly; slips apply to the rest.

    It matters only in directions that exact slips leave undetermined (see `_solve`): there the points follow the
    mean of the bodies, and so any common motion.
    """
    return 0.5 if coupling == "coupled" and not slip.sampled else 0.0


def _slip_matrices(slip: Slip, coupling: Coupling) -> tuple[np.ndarray, np.ndarray]:
    if coupling == "one-sided" or not slip.sampled:
        return slip.A, slip.B
    A, B = contract(np.stack([slip.A, slip.B]))
    return A, B


def _solve(M: np.ndarray, right: np.ndarray, exact: bool) -> np.ndarray:
    """Solve M x = right for x (..., 3).

    Exact slips may leave a direction undetermined, such as along two parallel faces, where M is singular: there
    the least-norm least-squares solution is taken. Clipped slips (`contract`) never do.
    """
    if not exact:
        return np.linalg.solve(M, right[..., None])[..., 0]
    U, values, V_transposed = np.linalg.svd(M)
    undetermined = values < _MIN_SINGULAR_VALUE
    inverse = np.where(undetermined, 0.0, 1.0 / np.where(undetermined, 1.0, values))
    return matvec(V_transposed.mT, inverse * matvec(U.mT, right))
