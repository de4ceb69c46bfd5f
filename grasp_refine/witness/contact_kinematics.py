"""Witness derivatives from contact kinematics: both surfaces as quadrics fitted to sampled normals.

Montana's contact equations (Montana 1988, "The kinematics of contact and grasp") for two smooth surfaces at
signed distance d. Unlike the slip equations they stay well conditioned as d -> 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from grasp_refine.collision.engine import chosen
from grasp_refine.core.arguments import check_fields
from grasp_refine.core.se3 import Array, array_namespace, cross, matvec, tangents
from grasp_refine.witness.curvature import RIDGE_RATIO, raise_eigenvalues, with_eigenvalues
from grasp_refine.witness.neighborhood import Adaptive, Fixed, Neighbors, distance_from
from grasp_refine.witness.pair_curvature import pair_curvatures
from grasp_refine.witness.relative import seen_from_a
from grasp_refine.witness.rings import Neighbor
from grasp_refine.witness.scene import WitnessScene
from grasp_refine.witness.slip import wrench

_RIM_FACTOR = 1.0001
"""Factor on the squared distance of the outermost sample, which keeps its weight above zero beyond the radius."""


@dataclass(frozen=True)
class ContactKinematics:
    """Sliding and rolling of the witness points on two surfaces with fitted curvature.

    With (v, w) = twist of b relative to a, V its velocity field and E a tangent basis:

        S = K_a + K_b + d K_b K_a,     u = S^-1 [E^T (w x n) + K_b E^T V(x_b)],
        dx_a = V_a(x_a) + E u,         dn = w_a x n + E K_a u,
        dx_b = V_a(x_b) + n (n . V(x_b)) + E (I + d K_a) u.

    Exact for smooth surfaces with the true curvatures K (2x2, positive for convex). Approximated: K, by a fit
    E^T n_j = b + K E^T (v_j - x) to the normals n_j of nearby samples v_j.
    """

    neighborhood: Adaptive | Fixed | Neighbor = field(default_factory=Adaptive)
    """Choice of the surface samples near a witness point."""
    sampled: bool = False
    """Fit to a few candidates, drawn as by the paper's methods: the neighbourhood's `samples`, at least its `minimum`.

    Otherwise only its radius counts, and the fit is to the candidates within it."""
    smallest_curvature: float = 5.0
    """Floor of the eigenvalues of K_a + K_b, divided by the mean of the two bodies' extents."""
    seed: int = 0
    """Seed of the random choice of samples."""

    def __post_init__(self) -> None:
        """Refuse settings of other types."""
        check_fields(self)

    def pull_back(
        self, scene: WitnessScene, force_a: np.ndarray, force_b: np.ndarray, force_n: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Wrenches (batch, pair, 6) on the two bodies from covectors on witness points and normal."""
        w = scene.witness
        E = tangents(w.normal)
        K_a, K_b = self.curvatures(scene, E)
        if chosen(scene.pairs.engine) == "native":
            from grasp_refine.witness import native_kinematics

            return native_kinematics.pull_back(w, E, (K_a, K_b), (force_a, force_b, force_n))
        d = effective_distance(K_a, K_b, w.distance)[..., None, None]
        # The equations of the class transposed; `slide` is the covector on u.
        in_plane = matvec(E.mT, force_a) + matvec(np.eye(2) + d * K_a, matvec(E.mT, force_b))
        if force_n is not None:
            in_plane = in_plane + matvec(K_a, matvec(E.mT, force_n))
        S = relative_curvature(K_a, K_b, w.distance)
        slide = np.linalg.solve(S.mT, in_plane[..., None])[..., 0]
        along = (force_b * w.normal).sum(axis=-1, keepdims=True) * w.normal
        relative = wrench(w.point_b, along + matvec(E, matvec(K_b, slide)))
        relative[..., 3:] += cross(w.normal, matvec(E, slide))
        return seen_from_a(w, force_a, force_b, force_n, relative)

    def pose_gradients(
        self, scene: WitnessScene, cotangents: Sequence[np.ndarray | None]
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Gradients (batch, pair, 4, 4) in the entries of both poses, see `derivative.PoseGradients`."""
        # A subclass may have curvatures of its own.
        if type(self) is not ContactKinematics or self._draws_samples:
            return None
        compiled = pair_curvatures(scene.pairs, self.smallest_curvature).compiled
        if compiled is None:
            return None
        return compiled.pose_gradients(scene.T_world_a, scene.T_world_b, scene.witness, self._radius(scene), cotangents)

    def curvatures(self, scene: WitnessScene, E: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fitted K_a and K_b (batch, pair, 2, 2) in 1/m, in the tangent basis E (batch, pair, 3, 2)."""
        if not self._draws_samples:
            T_a, T_b, tangents_of_items = (
                array.reshape(-1, *array.shape[2:]) for array in (scene.T_world_a, scene.T_world_b, E)
            )
            count, pairs = E.shape[:2]
            radius = np.broadcast_to(self._radius(scene), (2 * pairs, count)).reshape(2, pairs, count)
            fitted = pair_curvatures(scene.pairs, self.smallest_curvature).fit_within(
                np.tile(np.arange(pairs), count), T_a, T_b, scene.witness.reshape(-1), tangents_of_items,
                radius.swapaxes(1, 2).reshape(2, -1),
            )  # fmt: skip
            return fitted[0].reshape(*E.shape[:2], 2, 2), fitted[1].reshape(*E.shape[:2], 2, 2)
        sides, near = scene.neighbors(self.neighborhood, self.seed)
        basis = np.concatenate([E, E], axis=1).swapaxes(0, 1)
        K = _fit(near, sides.rotation.mT @ basis).swapaxes(0, 1)
        count = E.shape[1]
        extent = np.array([body.extent for body in (*scene.pairs.a, *scene.pairs.b)])
        floor = self.smallest_curvature / (0.5 * (extent[:count] + extent[count:]))
        return raise_eigenvalues(K[:, :count], K[:, count:], floor)

    @property
    def _draws_samples(self) -> bool:
        return self.sampled or isinstance(self.neighborhood, Neighbor)

    def _radius(self, scene: WitnessScene) -> np.ndarray:
        """Radii (2 pair, batch or 1) in metres of the neighbourhoods on the bodies a, then b."""
        assert not isinstance(self.neighborhood, Neighbor)
        away = None
        if (target := scene.targets_world()) is not None:
            points = np.concatenate([scene.witness.point_a, scene.witness.point_b], axis=1).swapaxes(0, 1)
            away = distance_from(target, points)
        return self.neighborhood.radius(scene.surfaces, away)


def contact_slip_jacobian(
    point_b: Array, normal: Array, distance: Array, E: Array, K_a: Array, K_b: Array
) -> tuple[Array, Array]:
    """Jacobians U_a and U_b (..., 2, 6) of the slip of the witness points on their bodies, along the tangents E.

    dx_a = V_a(x_a) + E U_a xi and dx_b = V_b(x_b) + E U_b xi, with xi the spatial twist (v, w) of body b relative
    to body a; the normal turns by dn = w_a x n + E K_a U_a xi. The equations of the class, with

        U_a = S^-1 [E^T (w x n) + K_b E^T V(x_b)],     U_b = (I + d K_a) U_a - E^T V(x_b).

    Args:
        point_b: Witness points on body b (..., 3), world frame.
        normal: Unit normals (..., 3) from a to b.
        distance: Signed distances (...).
        E: Tangents (..., 3, 2) as columns; with the normal, right-handed.
        K_a: Curvatures (..., 2, 2) of body a in that basis.
        K_b: Curvatures (..., 2, 2) of body b.
    """
    if isinstance(normal, np.ndarray) and chosen("auto") == "native":
        from grasp_refine.witness import native_kinematics

        return native_kinematics.slip_jacobians(point_b, normal, distance, E, K_a, K_b)
    xp = array_namespace(normal)
    rows = xp.matrix_transpose(E)
    moved = xp.concat([rows, cross(point_b[..., None, :] + xp.zeros_like(rows), rows)], axis=-1)
    # E^T (w x n) = (w . t_2, -w . t_1).
    turned = xp.concat([xp.zeros_like(rows), xp.stack([rows[..., 1, :], -rows[..., 0, :]], axis=-2)], axis=-1)
    S = relative_curvature(K_a, K_b, distance)
    determinant = S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] * S[..., 1, 0]
    adjugate = xp.stack(
        [xp.stack([S[..., 1, 1], -S[..., 0, 1]], axis=-1), xp.stack([-S[..., 1, 0], S[..., 0, 0]], axis=-1)], axis=-2
    )
    U_a = (adjugate / determinant[..., None, None]) @ (turned + K_b @ moved)
    d = effective_distance(K_a, K_b, distance)[..., None, None]
    return U_a, U_a + d * (K_a @ U_a) - moved


def relative_curvature(K_a: Array, K_b: Array, distance: Array) -> Array:
    """S = K_a + K_b + d K_b K_a (..., 2, 2) with the effective d; its determinant is positive where K's are."""
    return K_a + K_b + effective_distance(K_a, K_b, distance)[..., None, None] * (K_b @ K_a)


def effective_distance(K_a: Array, K_b: Array, distance: Array) -> Array:
    """Effective signed distances d (...), limited such that S does not become singular and change sign.

    In penetration deeper than a radius of curvature, and between surfaces as far apart as a concavity is deep,
    witness points stop following the surfaces smoothly, and the equations would make them slide the wrong way. With x
    the smaller of the two curvatures times |d|, d counts fully up to x = 1/2, and above that by (1 - x) / x: corners
    deep inside each other thus keep their points.
    """
    xp = array_namespace(K_a)
    product = K_b @ K_a
    bend = distance * (product[..., 0, 0] + product[..., 1, 1])
    x = xp.abs(distance) * xp.minimum(_max_curvature(K_a), _max_curvature(K_b))
    beyond = (bend < 0) & (x > 0.5)
    share = xp.where(beyond, (1.0 - x) / xp.where(beyond, x, xp.ones_like(x)), xp.ones_like(x))
    return share * distance


def _max_curvature(K: Array) -> Array:
    """Largest absolute eigenvalue (...) of symmetric matrices K (..., 2, 2)."""
    xp = array_namespace(K)
    mean, half = 0.5 * (K[..., 0, 0] + K[..., 1, 1]), 0.5 * (K[..., 0, 0] - K[..., 1, 1])
    return xp.abs(mean) + xp.sqrt(half * half + K[..., 0, 1] * K[..., 0, 1])


def _fit(near: Neighbors, E: np.ndarray) -> np.ndarray:
    """Symmetric curvatures K (S, B, 2, 2) with E^T n_j = b + K E^T (v_j - x), by weighted least squares.

    Weights fall to zero at the radius rho; eigenvalues are clipped to [-1/rho, 4/rho], the range that samples of
    that spread can resolve.
    """
    offset = near.points[..., 1:, :] - near.points[..., :1, :]
    squared = np.where(near.mask[..., 1:], (offset * offset).sum(axis=-1), 0.0)
    rho_squared = np.maximum(near.radius**2, _RIM_FACTOR * squared.max(axis=-1))[..., None]
    weight = np.where(near.mask[..., 1:], 1.0 - squared / rho_squared, 0.0)
    weight /= np.maximum(weight.sum(axis=-1, keepdims=True), np.finfo(np.float64).tiny)
    e, n = offset @ E, near.normals @ E
    e = e - (weight[..., None, :] @ e)
    n = n - (weight[..., None, :] @ n)
    weighted = (weight[..., None] * e).mT
    ridge = RIDGE_RATIO * rho_squared[..., None] * np.eye(2)
    K = np.linalg.solve(weighted @ e + ridge, weighted @ n)
    rho = np.sqrt(rho_squared)[..., 0]
    return with_eigenvalues(0.5 * (K + K.mT), lambda values: np.clip(values, -1.0 / rho, 4.0 / rho))
