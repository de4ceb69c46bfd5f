"""Algebra shared by all slip methods: the motion of witness points of two moving bodies.

Body a at rest, a point y outside it: its closest point is x_a = f(y), with slip matrix A = df/dy (3x3, world
frame). For a moving rigidly with the velocity field V_a, equivariance gives the rest:

    dx_a = V_a(x_a) + A (dx_b - V_a(x_b)),        dx_b = V_b(x_b) + B (dx_a - V_b(x_a)).

"coupled" solves the two equations together. "one-sided" is arXiv 2511.06267: the other witness point of each
self term is held fixed, dx_a = V_a(x_a) - A V_a(x_b) + A [V_b(x_b) - B V_b(x_a)]; it needs no inverse and is
*not* invariant when both bodies move together.
"""

from dataclasses import dataclass
from typing import Literal

from grasp_refine.core.se3 import Array, array_namespace, cross, matvec
from grasp_refine.witness.scene import WitnessScene

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

    A: Array
    """dx_a / dx_b with body a at rest (..., 3, 3), world frame."""
    B: Array
    """dx_b / dx_a with body b at rest (..., 3, 3), world frame."""
    self_a: Array
    """Point (..., 3) that moves rigidly with body a in its self term: x_a, or the smoothed point x_a*."""
    self_b: Array
    """Point (..., 3) that moves rigidly with body b in its self term."""
    sampled: bool = True
    """Whether A and B are estimates: the coupled solve then clips their eigenvalues to [0, 1)."""


def push_forward(
    slip: Slip, point_a: Array, point_b: Array, twist_a: Array, twist_b: Array, coupling: Coupling = "coupled"
) -> tuple[Array, Array]:
    """Velocities (dx_a, dx_b) (..., 3) of the witness points under spatial twists (v, w) (..., 6) of the bodies."""
    A, B = _slip_matrices(slip, coupling)
    common = _common_share(slip, coupling) * (twist_a + twist_b)
    twist_a, twist_b = twist_a - common, twist_b - common
    own_a = _velocity(twist_a, slip.self_a) - matvec(A, _velocity(twist_a, point_b))
    own_b = _velocity(twist_b, slip.self_b) - matvec(B, _velocity(twist_b, point_a))
    if coupling == "one-sided":
        return own_a + matvec(A, own_b), own_b + matvec(B, own_a)
    dx_a = _solve(_identity_minus(A @ B), own_a + matvec(A, own_b), exact=not slip.sampled)
    return dx_a + _velocity(common, point_a), own_b + matvec(B, dx_a) + _velocity(common, point_b)


def pull_back(
    slip: Slip, point_a: Array, point_b: Array, force_a: Array, force_b: Array, coupling: Coupling = "coupled"
) -> tuple[Array, Array]:
    """Wrenches (..., 6) on the two bodies from covectors on the witness points: the transpose of `push_forward`.

    Args:
        slip: Slip matrices.
        point_a: Witness points (..., 3), world frame.
        point_b: Witness points (..., 3) on body b, world frame.
        force_a: dL/dx_a (..., 3).
        force_b: dL/dx_b (..., 3).
        coupling: As in `push_forward`.

    Returns:
        Covectors (f, m) on the spatial twists of body a and body b: dL = f . v + m . w.
    """
    xp = array_namespace(slip.A)
    A, B = _slip_matrices(slip, coupling)
    A_transposed, B_transposed = xp.matrix_transpose(A), xp.matrix_transpose(B)
    if coupling == "one-sided":
        lambda_a = force_a + matvec(B_transposed, force_b)
        lambda_b = force_b + matvec(A_transposed, force_a)
    else:
        right = force_a + matvec(B_transposed, force_b)
        lambda_a = _solve(_identity_minus(B_transposed @ A_transposed), right, exact=not slip.sampled)
        lambda_b = force_b + matvec(A_transposed, lambda_a)
    # About a witness point: these forces may be large and cancel, as do their moments about a distant origin.
    points = xp.stack([slip.self_a, slip.self_b, point_b, point_a]) - point_a
    forces = xp.stack([lambda_a, lambda_b, -matvec(A_transposed, lambda_a), -matvec(B_transposed, lambda_b)])
    wrenches = wrench(points, forces)
    both = wrenches[:2] + wrenches[2:]
    if share := _common_share(slip, coupling):
        total = wrench(points[3], force_a) + wrench(points[2], force_b)
        both = both + share * (total - both[0] - both[1])
    force = both[..., :3]
    both = xp.concat([force, both[..., 3:] + cross(point_a + xp.zeros_like(force), force)], axis=-1)
    return both[0], both[1]


def pull_back_witness(
    slip: Slip, scene: WitnessScene, force_a: Array, force_b: Array, force_n: Array | None, coupling: Coupling
) -> tuple[Array, Array]:
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


def wrench(point: Array, force: Array) -> Array:
    """Wrench (f, p x f) (..., 6) at the world origin of a force (..., 3) at a point (..., 3)."""
    return array_namespace(point).concat([force, cross(point, force)], axis=-1)


def contract(matrix: Array) -> Array:
    """Symmetric part of slip matrices (..., 3, 3) with eigenvalues clipped to [0, 1 - 1e-6].

    A sampled covariance can have eigenvalues above 1, for which I - A B would change sign.
    """
    xp = array_namespace(matrix)
    M = 0.5 * (matrix + xp.matrix_transpose(matrix))
    bad = ~(_positive_definite(M, floor=-1e-9) & _positive_definite(-M, floor=-_MAX_SLIP))
    if not bool(xp.any(bad)):
        return M
    values, vectors = xp.linalg.eigh(M[bad])
    values = xp.clip(values, 0.0, _MAX_SLIP)
    M[bad] = (vectors * values[..., None, :]) @ xp.matrix_transpose(vectors)
    return M


def _positive_definite(M: Array, floor: float) -> Array:
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


def _slip_matrices(slip: Slip, coupling: Coupling) -> tuple[Array, Array]:
    if coupling == "one-sided" or not slip.sampled:
        return slip.A, slip.B
    both = contract(array_namespace(slip.A).stack([slip.A, slip.B]))
    return both[0], both[1]


def _solve(M: Array, right: Array, exact: bool) -> Array:
    """Solve M x = right for x (..., 3).

    Exact slips may leave a direction undetermined, such as along two parallel faces, where M is singular: there
    the least-norm least-squares solution is taken. Clipped ones (`contract`) never do.
    """
    xp = array_namespace(M)
    if not exact:
        return xp.linalg.solve(M, right[..., None])[..., 0]
    U, values, V_transposed = xp.linalg.svd(M)
    open_ = values < _MIN_SINGULAR_VALUE
    inverse = xp.where(open_, xp.zeros_like(values), 1.0 / xp.where(open_, xp.ones_like(values), values))
    return matvec(xp.matrix_transpose(V_transposed), inverse * matvec(xp.matrix_transpose(U), right))


def _velocity(twist: Array, point: Array) -> Array:
    return twist[..., :3] + cross(twist[..., 3:], point)


def _identity_minus(M: Array) -> Array:
    result = -M
    for i in range(3):
        result[..., i, i] += 1.0
    return result
