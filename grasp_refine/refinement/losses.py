"""Loss terms of a grasp: per term, one pure function that returns residuals, and one that returns their derivatives.

The balance of contact forces is a term too, that of `equilibrium`.

A loss is the sum of squared residuals times weights, without a factor of one half, in square metres. Residuals are
written against the array API: on torch tensors they keep their graph, which descent follows; least squares takes
the derivatives, which are *covectors*: rows g with dr = g . (v, w), (v, w) the spatial twist of a link at the world's
origin, while the object rests. Distances have exact derivatives; how witness points slide is contact kinematics.
"""

from dataclasses import dataclass, fields
from math import inf

from grasp_refine.collision.query import Witness
from grasp_refine.core.arguments import check_fields
from grasp_refine.core.errors import GraspRefineError
from grasp_refine.core.se3 import Array, array_namespace, cross, log_so3, transform_points
from grasp_refine.witness.contact_kinematics import contact_slip_jacobian


@dataclass(frozen=True)
class Weights:
    """Weights of the terms in the sum of squares."""

    contact: float = 1.0
    """Weight of gaps and of target misses (metres) of the links that should touch."""
    penetration: float = 100.0
    """Weight of the depth of every link in the object (metres); descent and adam are faster with 10."""
    self_penetration: float = 100.0
    """Weight of the depth of links in each other (metres); likewise."""
    table: float = 100.0
    """Weight of the depth of every link below the table, where there is one (metres)."""
    joint_limits: float = 0.01
    """Weight of joint values beyond their limits (radians, or metres for prismatic joints), in m^2/rad^2; with
    levenberg-marquardt, limits hold exactly and it has no effect."""
    stay_near: float = 0.0
    """Weight of the movement from the initial grasp, whose units are those of `Scales`, in m^2."""
    wrench: float = 1.6e-3
    """Weight of the wrench that the best contact forces leave unbalanced, per unit of total pressure, in m^2; with
    levenberg-marquardt and without targets only."""
    direction: float = 1e-3
    """Weight of contact normals that differ from target normals (1 - their cosine is half the square), in m^2."""

    def __post_init__(self) -> None:
        """Refuse weights that are negative or not finite.

        Raises:
            GraspRefineError: names the weight that is below 0 or not a finite number.
        """
        check_fields(self)
        for field in fields(self):
            if not 0.0 <= getattr(self, field.name) < inf:
                raise GraspRefineError(
                    f"weights: {field.name} must be at least 0 and finite, got {getattr(self, field.name):g}"
                )


@dataclass(frozen=True)
class Scales:
    """Movements of equal cost."""

    translation: float = 0.01
    """Translation of the root, in metres."""
    rotation: float = 0.1
    """Rotation of the root, in radians."""
    joints: float = 0.15
    """Movement of a joint, in radians (metres for prismatic joints)."""

    def __post_init__(self) -> None:
        """Refuse scales that are not positive.

        Raises:
            GraspRefineError: a scale is not above 0.
        """
        check_fields(self)
        for name in ("translation", "rotation", "joints"):
            if not getattr(self, name) > 0.0:
                raise GraspRefineError(f"scales: {name} must be above 0, got {getattr(self, name):g}")


def contact_targets(
    witness: Witness,
    T_world_a: Array,
    T_world_b: Array,
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
        T_world_b: Poses of the second bodies.
        target_a: Target points on body a (..., pair, 3), its own frame, metres.
        target_b: Target points on body b (..., pair, 3), its own frame, metres.
        margin: Contact margin beta in metres: the target signed distance.
    """
    xp = array_namespace(target_a)
    known = xp.asarray(witness.valid, device=target_a.device)
    aimed = ~(xp.any(xp.isnan(target_a), axis=-1) | xp.any(xp.isnan(target_b), axis=-1))
    miss_a = witness.point_a - transform_points(T_world_a, _without_nan(target_a))
    miss_b = witness.point_b - transform_points(T_world_b, _without_nan(target_b))
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
    return xp.concat([gap_covectors(witness)[..., None, :], -U_a, -U_b], axis=-2)


def contact_gap(witness: Witness, touching: Array, margin: float = 0.0) -> Array:
    """Return d - beta (..., pair) in metres of links that should touch; zero for others and without witness points."""
    xp = array_namespace(witness.distance)
    wanted = xp.asarray(witness.valid, device=witness.distance.device) & touching
    return xp.where(wanted, witness.distance - margin, xp.zeros_like(witness.distance))


def gap_covectors(witness: Witness) -> Array:
    """Return covectors (..., 6) of the signed distance: -(n, x_b x n) on the twist of body a, exact."""
    xp = array_namespace(witness.normal)
    return -xp.concat([witness.normal, cross(witness.point_b, witness.normal)], axis=-1)


def penetration(witness: Witness) -> Array:
    """Return the penetration depth max(0, -d) (..., pair) in metres; zero where a pair has no witness points.

    The derivative is that of -d where it is positive (see `gap_covectors`). It holds for two links of a hand too;
    then the covector acts on the twist of the first less that of the second.
    """
    xp = array_namespace(witness.distance)
    deep = xp.asarray(witness.valid, device=witness.distance.device) & (witness.distance < 0)
    return xp.where(deep, -witness.distance, xp.zeros_like(witness.distance))


def joint_limits(q: Array, lower: Array, upper: Array) -> Array:
    """Return the distances of joint values (..., n) beyond their limits (n,), in their own unit (rad or m)."""
    xp = array_namespace(q)
    zero = xp.zeros_like(q)
    return xp.maximum(q - upper, zero) + xp.maximum(lower - q, zero)


def joint_limits_jacobian(q: Array, lower: Array, upper: Array) -> Array:
    """Return the diagonal (..., n) of the derivative in q: 1 above, -1 below, 0 within."""
    xp = array_namespace(q)
    one, zero = xp.ones_like(q), xp.zeros_like(q)
    return xp.where(q > upper, one, zero) - xp.where(q < lower, one, zero)


def plane_depth(points: Array, normal: Array, offset: float) -> Array:
    """Return depths offset - n . p (...) in metres of points (..., 3) below a plane, as of a table; negative above."""
    xp = array_namespace(points)
    return offset - xp.sum(points * normal, axis=-1)


def plane_covectors(points: Array, normal: Array) -> Array:
    """Return covectors -(n, p x n) (..., 6) of `plane_depth` on the twists of the bodies of the points."""
    xp = array_namespace(points)
    spread = normal + xp.zeros_like(points)
    return -xp.concat([spread, cross(points, spread)], axis=-1)


def below_plane(points: Array, normal: Array, offset: float) -> Array:
    """Return depths max(0, offset - n . p) (...) in metres of points (..., 3) below a plane."""
    xp = array_namespace(points)
    depth = plane_depth(points, normal, offset)
    return xp.maximum(depth, xp.zeros_like(depth))


def stay_near(T: Array, q: Array, T_first: Array, q_first: Array, scales: Scales) -> Array:
    """Return the movement (..., 6 + n) from the initial root pose and joint values, in units of `scales`.

    [(p - p_0) / s_t, log(R R_0^T) / s_r, (q - q_0) / s_q], world frame.
    """
    xp = array_namespace(q)
    turned = log_so3(T[..., :3, :3] @ xp.matrix_transpose(T_first[..., :3, :3]))
    moved = T[..., :3, 3] - T_first[..., :3, 3]
    return xp.concat([moved / scales.translation, turned / scales.rotation, (q - q_first) / scales.joints], axis=-1)


def stay_near_jacobian(residual: Array, scales: Scales) -> Array:
    """Return the derivative (..., 6 + n, 6 + n) of `stay_near` in (v, w, q), the root turning about its own origin.

    Exact except for the rotation, d log = J_l^-1(log) w, taken to second order of the angle.
    """
    xp = array_namespace(residual)
    n = residual.shape[-1]
    jacobian = xp.zeros_like(residual[..., None] + residual[..., None, :])
    for i in range(n):
        jacobian[..., i, i] = 1.0 / (scales.translation if i < 3 else scales.rotation if i < 6 else scales.joints)
    w = residual[..., 3:6] * scales.rotation
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        jacobian[..., 3 + k, 3 + j] = -0.5 * w[..., i] / scales.rotation
        jacobian[..., 3 + j, 3 + k] = 0.5 * w[..., i] / scales.rotation
    square = w[..., :, None] * w[..., None, :]
    length = xp.sum(w * w, axis=-1)[..., None]
    jacobian[..., 3:6, 3:6] += square / (12.0 * scales.rotation)
    for i in range(3, 6):
        jacobian[..., i, i] -= length[..., 0] / (12.0 * scales.rotation)
    return jacobian


def contact_direction(witness: Witness, wanted: Array) -> Array:
    """Return n - n_target (..., pair, 3) of the contact normals, from link to object; zero without a target (NaN).

    Args:
        witness: Witness points, world frame.
        wanted: Target unit normals (..., pair, 3), world frame. The force that a link exerts points along its normal.
    """
    xp = array_namespace(wanted)
    known = xp.asarray(witness.valid, device=wanted.device) & ~xp.any(xp.isnan(wanted), axis=-1)
    difference = witness.normal - _without_nan(wanted)
    return xp.where(known[..., None], difference, xp.zeros_like(difference))


def contact_direction_covectors(witness: Witness, E: Array, K_a: Array, K_b: Array) -> Array:
    """Return covectors (..., 3, 6) of the contact normal: dn = w_a x n + E K_a u (see `contact_kinematics`)."""
    xp = array_namespace(E)
    U_a, _ = contact_slip_jacobian(witness.point_b, witness.normal, witness.distance, E, K_a, K_b)
    n = witness.normal
    # Rows of w -> w x n: e_i . (w x n) = w . (n x e_i).
    eye = xp.eye(3, dtype=n.dtype, device=n.device) + xp.zeros_like(n[..., None])
    turn = cross(n[..., None, :] + xp.zeros_like(eye), eye)
    return xp.concat([xp.zeros_like(turn), turn], axis=-1) - E @ (K_a @ U_a)


def _without_nan(array: Array) -> Array:
    xp = array_namespace(array)
    return xp.where(xp.isnan(array), xp.zeros_like(array), array)
