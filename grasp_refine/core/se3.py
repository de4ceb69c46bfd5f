"""Rotations and rigid transforms of NumPy arrays and torch tensors alike (array API).

Twists are (v, w), linear part first. A *spatial* twist moves the point p (world frame) with velocity
V(p) = v + w x p, so T(t) = exp(t xi) T(0); a *body* twist moves T(t) = T(0) exp(t xi).
All functions take any number of leading batch dimensions.
"""

from math import factorial, prod
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from grasp_refine.core.arguments import as_numbers, check_alike, check_shape
from grasp_refine.core.errors import GraspRefineError

Array = Any
"""A NumPy array or a torch tensor."""

if TYPE_CHECKING:
    from torch import Tensor

    Same = TypeVar("Same", np.ndarray, Tensor)
else:
    # Importing torch takes a second, and only type checkers need it here.
    Same = Any

SKEWED = 1e-3
"""Largest deviation of a rotation matrix from its cofactors, and of a unit vector from length 1: rounding passes, a
mix-up does not."""

_ROTATION = np.array([0, 1, 2, 4, 5, 6, 8, 9, 10])
"""Indices of the rotation's entries among the 16 of a transform."""
_LAST_ROW = np.array([[0.0], [0.0], [0.0], [1.0]])
"""Last row (4, 1) of every rigid transform."""
_COFACTORS = tuple(
    np.array([3 * ((row + down) % 3) + (column + right) % 3 for row in range(3) for column in range(3)])
    for down, right in ((1, 1), (2, 2), (1, 2), (2, 1))
)
"""Indices of entries of a 3 x 3 matrix: entry (i, j) has the cofactor R[i + 1, j + 1] R[i + 2, j + 2] -
R[i + 1, j + 2] R[i + 2, j + 1], indices modulo 3."""

_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])
"""Indices of the two axes after each axis."""

UNIT = 1e-3
"""Largest deviation of a quaternion's squared length from 1: rounding to float32 passes, a mix-up does not."""

_SMALL_ANGLE_SQUARED = 1e-8
"""Below this squared angle (rad^2) the maps use their Taylor series; its error is then below 1e-16."""

_SHIFT_ANGLE_SQUARED = 1e-2
"""Squared angle (rad^2) below which (x - sin x)/x^3, which cancels, uses its series: its derivative would lose
eps/x^4."""

_SHIFT_SERIES = tuple((-1.0) ** k / factorial(2 * k + 3) for k in reversed(range(4)))
"""Taylor coefficients of that function in x^2, the highest power first."""


def array_namespace(array: Array) -> ModuleType:
    """The array API of an array: NumPy itself, which conforms since version 2, or a wrapped library."""
    # The shortcut matters: small steps call this some twenty times, at 5 us each otherwise.
    if isinstance(array, (np.ndarray, np.generic)):
        return np
    import array_api_compat

    return array_api_compat.array_namespace(array)


def cross(a: Same, b: Same) -> Same:
    """Cross product a x b of vectors (..., 3)."""
    return _entries(a, _NEXT) * _entries(b, _AFTER) - _entries(a, _AFTER) * _entries(b, _NEXT)


def _entries(vector: Same, places: np.ndarray) -> Same:
    """Entries (..., P) of vectors at some places (P,)."""
    # NumPy takes four times as long to index by an array.
    return vector.take(places, axis=-1) if isinstance(vector, np.ndarray) else vector[..., places]


def hat(w: Same) -> Same:
    """Skew matrices [w] (..., 3, 3) of vectors (..., 3): [w] p = w x p."""
    xp = array_namespace(w)
    skew = xp.zeros_like(w[..., None] + w[..., None, :])
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        skew[..., k, j] = w[..., i]
        skew[..., j, k] = -w[..., i]
    return skew


def vee(matrix: Same) -> Same:
    """The vector w (..., 3) whose skew matrix [w] is the skew part (M - M^T) / 2 of a matrix (..., 3, 3)."""
    xp = array_namespace(matrix)
    m = matrix
    return 0.5 * xp.stack(
        [m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]], axis=-1
    )


def matvec(matrix: Same, vector: Same) -> Same:
    """The products of matrices (..., m, n) and vectors (..., n), with broadcasting."""
    return (matrix @ vector[..., None])[..., 0]


def _sinc_coefficients(angle_squared: Same) -> tuple[Same, Same]:
    """The coefficients sin(x)/x and (1 - cos x)/x^2 as functions of x^2, smooth at zero."""
    xp = array_namespace(angle_squared)
    small = angle_squared < _SMALL_ANGLE_SQUARED
    # The guarded angle keeps the branch that is not taken, and its gradient, finite.
    angle = xp.sqrt(xp.where(small, xp.ones_like(angle_squared), angle_squared))
    half = xp.sin(0.5 * angle)
    a = xp.where(small, 1.0 - angle_squared / 6.0, xp.sin(angle) / angle)
    b = xp.where(small, 0.5 - angle_squared / 24.0, 2.0 * half * half / (angle * angle))
    return a, b


def _shift_coefficient(angle_squared: Same) -> Same:
    """The coefficient (x - sin x)/x^3 as a function of x^2, smooth at zero."""
    xp = array_namespace(angle_squared)
    small = angle_squared < _SHIFT_ANGLE_SQUARED
    square = xp.where(small, angle_squared, xp.zeros_like(angle_squared))
    series = _SHIFT_SERIES[0] * square + _SHIFT_SERIES[1]
    for coefficient in _SHIFT_SERIES[2:]:
        series = series * square + coefficient
    angle = xp.sqrt(xp.where(small, xp.ones_like(angle_squared), angle_squared))
    return xp.where(small, series, (angle - xp.sin(angle)) / angle**3)


def exp_so3(w: Same) -> Same:
    """Rotation matrix (..., 3, 3) of a rotation vector (..., 3) in radians (Rodrigues' formula)."""
    xp = array_namespace(w)
    a, b = _sinc_coefficients(xp.sum(w * w, axis=-1))
    skew = hat(w)
    return _identity_like(skew) + a[..., None, None] * skew + b[..., None, None] * (skew @ skew)


def log_so3(R: Same) -> Same:
    """Rotation vector (..., 3) of a rotation matrix (..., 3, 3), with angle in [0, pi]."""
    xp = array_namespace(R)
    quaternion = quaternion_from_matrix(R)
    w, xyz = quaternion[..., 0], quaternion[..., 1:]
    flip = xp.where(w < 0, -xp.ones_like(w), xp.ones_like(w))
    w, xyz = w * flip, xyz * flip[..., None]
    squared = xp.sum(xyz * xyz, axis=-1)
    small = squared < _SMALL_ANGLE_SQUARED
    norm = xp.sqrt(xp.where(small, xp.ones_like(squared), squared))
    # Near the identity angle / norm(xyz) = 2 atan2(s, c) / s -> 2 / c - 2 s^2 / (3 c^3).
    series = 2.0 / xp.where(small, w, xp.ones_like(w)) * (1.0 - squared / 3.0)
    return xyz * xp.where(small, series, 2.0 * xp.atan2(norm, w) / norm)[..., None]


def exp_se3(twist: Same) -> Same:
    """Transform (..., 4, 4) of a twist (v, w) (..., 6) followed for unit time.

    Raises:
        GraspRefineError: another shape.
    """
    twist = _as_array("twist", twist, "...", 6)
    xp = array_namespace(twist)
    v, w = twist[..., :3], twist[..., 3:]
    angle_squared = xp.sum(w * w, axis=-1)
    (a, b), c = _sinc_coefficients(angle_squared), _shift_coefficient(angle_squared)
    skew = hat(w)
    square = skew @ skew
    eye = _identity_like(skew)
    R = eye + a[..., None, None] * skew + b[..., None, None] * square
    left = eye + b[..., None, None] * skew + c[..., None, None] * square
    return transform(R, matvec(left, v))


def first_order_twist(T: Same, T_before: Same) -> Same:
    """Spatial twist (v, w) (..., 6) that takes poses (..., 4, 4) `T_before` to `T` nearby, to first order."""
    moved = T @ inverse(T_before)
    return array_namespace(T).concat([moved[..., :3, 3], vee(moved[..., :3, :3])], axis=-1)


def transform(R: Same, p: Same) -> Same:
    """Homogeneous matrix (..., 4, 4) of a rotation (..., 3, 3) and a translation (..., 3)."""
    xp = array_namespace(R)
    top = xp.concat([R, p[..., None]], axis=-1)
    bottom = xp.zeros_like(top[..., :1, :])
    bottom[..., 0, 3] = 1.0
    return xp.concat([top, bottom], axis=-2)


def inverse(T: Same) -> Same:
    """Inverse of a rigid transform (..., 4, 4)."""
    xp = array_namespace(T)
    R_transposed = xp.matrix_transpose(T[..., :3, :3])
    return transform(R_transposed, -matvec(R_transposed, T[..., :3, 3]))


def distances(before: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances (N,) in metres and angles (N,) in radians between poses (N, 4, 4); NaN where one is not finite."""
    finite = np.isfinite(before).all(axis=(-2, -1)) & np.isfinite(after).all(axis=(-2, -1))
    before, after = (np.where(finite[:, None, None], T, np.eye(4)) for T in (before, after))
    moved = np.linalg.norm(after[:, :3, 3] - before[:, :3, 3], axis=-1)
    turned = np.linalg.norm(log_so3(before[:, :3, :3].mT @ after[:, :3, :3]), axis=-1)
    return np.where(finite, moved, np.nan), np.where(finite, turned, np.nan)


def is_rigid(T: np.ndarray) -> np.ndarray:
    """Mask (...) of the transforms (..., 4, 4) that are rigid motions up to rounding; false where not finite.

    A rotation matrix, and no other but 0, is its own matrix of cofactors.
    """
    entries = np.ascontiguousarray(T.reshape(prod(T.shape[:-2]), 16).T)
    R = entries.take(_ROTATION, axis=0)
    with np.errstate(invalid="ignore", over="ignore"):
        first, second, third, fourth = (R.take(places, axis=0) for places in _COFACTORS)
        off = np.abs(R - (first * second - third * fourth)).max(axis=0)
        rigid = (off <= SKEWED) & ((R[:3] ** 2).sum(axis=0) > 0.5)
    return (rigid & (entries[12:] == _LAST_ROW).all(axis=0)).reshape(T.shape[:-2])


def transform_points(T: Same, points: Same) -> Same:
    """Points (..., 3) mapped by transforms (..., 4, 4)."""
    return matvec(T[..., :3, :3], points) + T[..., :3, 3]


def retract(T: Same, body_twist: Same) -> Same:
    """T exp(xi): the transform moved by a body twist (..., 6), its rotation orthonormalised again."""
    moved = T @ exp_se3(body_twist)
    return transform(_orthonormalised(moved[..., :3, :3]), moved[..., :3, 3])


def tangents(normal: Same) -> Same:
    """Two unit tangents as columns (..., 3, 2) of each unit normal n (..., 3); (t_1, t_2, n) is right-handed.

    Duff et al. 2017, "Building an orthonormal basis, revisited".
    """
    xp = array_namespace(normal)
    x, y, z = normal[..., 0], normal[..., 1], normal[..., 2]
    sign = xp.where(z < 0, -xp.ones_like(z), xp.ones_like(z))
    a = -1.0 / (sign + z)
    b = x * y * a
    first = xp.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    second = xp.stack([b, sign + y * y * a, -y], axis=-1)
    return xp.stack([first, second], axis=-1)


def frame_along(axis: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) whose first column is `axis` (3,), of any length."""
    along = axis / np.linalg.norm(axis)
    return np.column_stack([along, tangents(along)])


def matrix_from_quaternion(quaternion: Same) -> Same:
    """Rotation matrix (..., 3, 3) of a unit quaternion (w, x, y, z) (..., 4)."""
    xp = array_namespace(quaternion)
    w, x, y, z = (quaternion[..., i] for i in range(4))
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_from_matrix(R: Same) -> Same:
    """Unit quaternion (w, x, y, z) (..., 4) of a rotation matrix (..., 3, 3); w may have either sign."""
    xp = array_namespace(R)
    m00, m11, m22 = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    yz, zx, xy = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    sxy, szx, syz = R[..., 0, 1] + R[..., 1, 0], R[..., 0, 2] + R[..., 2, 0], R[..., 1, 2] + R[..., 2, 1]
    # The four candidates are 4 q_i q; the one with the largest q_i is well conditioned.
    candidates = xp.stack(
        [
            xp.stack([1 + m00 + m11 + m22, yz, zx, xy], axis=-1),
            xp.stack([yz, 1 + m00 - m11 - m22, sxy, szx], axis=-1),
            xp.stack([zx, sxy, 1 - m00 + m11 - m22, syz], axis=-1),
            xp.stack([xy, szx, syz, 1 - m00 - m11 + m22], axis=-1),
        ],
        axis=-2,
    )
    diagonal = xp.stack([candidates[..., i, i] for i in range(4)], axis=-1)
    largest = xp.max(diagonal, axis=-1, keepdims=True)
    chosen = xp.astype(diagonal == largest, R.dtype)
    # Of equal candidates the first one is taken.
    first = chosen * xp.astype(xp.cumulative_sum(chosen, axis=-1) == 1.0, R.dtype)
    quaternion = xp.sum(candidates * first[..., None], axis=-2)
    return quaternion / xp.sqrt(xp.sum(quaternion * quaternion, axis=-1, keepdims=True))


def transform_from_pose(pose: Same) -> Same:
    """Transform (..., 4, 4) of a pose (x, y, z, qw, qx, qy, qz) (..., 7).

    Poses that are not finite give transforms that are not.

    Raises:
        GraspRefineError: another shape, or a quaternion that is not of unit length.
    """
    pose = _as_array("pose", pose, "...", 7)
    squared = (pose[..., 3:] * pose[..., 3:]).sum(-1).reshape(-1)
    wrong = abs(squared - 1) > UNIT
    if wrong.any():
        length = float(squared[wrong][0]) ** 0.5
        if length < np.inf:
            raise GraspRefineError(f"a pose is x y z qw qx qy qz with a unit quaternion; its length is {length:.6g}")
    return transform(matrix_from_quaternion(pose[..., 3:]), pose[..., :3])


def pose_from_transform(T: Same) -> Same:
    """Pose (x, y, z, qw, qx, qy, qz) (..., 7) of a transform (..., 4, 4), with qw >= 0.

    Transforms that are not rigid give meaningless poses.

    Raises:
        GraspRefineError: another shape.
    """
    T = _as_array("transform", T, "...", 4, 4)
    xp = array_namespace(T)
    quaternion = quaternion_from_matrix(T[..., :3, :3])
    sign = xp.where(quaternion[..., :1] < 0, -xp.ones_like(quaternion[..., :1]), xp.ones_like(quaternion[..., :1]))
    return xp.concat([T[..., :3, 3], quaternion * sign], axis=-1)


def ambient_gradient(T: Same, wrench: Same) -> Same:
    """Gradient (..., 4, 4) in the entries of T whose pairing with any rigid motion is that of a wrench.

    A wrench (f, m) (..., 6) is a covector on spatial twists: dL = f . v + m . w. With dR = [w] R and
    dp = v + w x p, the matrix (1/2 [m - p x f] R, f) gives <G, dT> = dL.
    """
    xp = array_namespace(T)
    force, moment = wrench[..., :3], wrench[..., 3:]
    G_R = 0.5 * (hat(moment - cross(T[..., :3, 3], force)) @ T[..., :3, :3])
    top = xp.concat([G_R, force[..., None]], axis=-1)
    return xp.concat([top, xp.zeros_like(top[..., :1, :])], axis=-2)


def body_gradient(T: Same, G: Same) -> Same:
    """Body twist (v, w) (..., 6) for a gradient G (..., 4, 4) in the entries of a transform T, as torch returns it.

    It is Proj(T^-1 G): v = R^T G_p and w = vee(skew(R^T G_R)), which is *half* the derivative of the loss along a body
    rotation (arXiv 2511.06267 uses the same projection).

    Raises:
        GraspRefineError: another shape.
    """
    T, G = _as_array("transform", T, "...", 4, 4), _as_array("gradient", G, "...", 4, 4)
    check_alike(T, G)
    xp = array_namespace(T)
    R_transposed = xp.matrix_transpose(T[..., :3, :3])
    return xp.concat([matvec(R_transposed, G[..., :3, 3]), vee(R_transposed @ G[..., :3, :3])], axis=-1)


def _as_array(name: str, value: Same, *shape: int | str) -> Same:
    """Return an argument of a public function with its shape checked; lists become arrays."""
    if isinstance(value, list | tuple):
        value = as_numbers(name, value)
    check_shape(name, value, *shape)
    return value


def _identity_like(matrix: Same) -> Same:
    xp = array_namespace(matrix)
    n = matrix.shape[-1]
    keywords = {"device": matrix.device} if hasattr(matrix, "is_cuda") else {}
    return xp.eye(n, dtype=matrix.dtype, **keywords)


def _orthonormalised(R: Same) -> Same:
    """One Newton step towards the nearest rotation; removes the rounding that products accumulate."""
    xp = array_namespace(R)
    return R @ (1.5 * _identity_like(R) - 0.5 * (xp.matrix_transpose(R) @ R))
