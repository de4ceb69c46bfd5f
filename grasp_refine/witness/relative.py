"""Derivatives from the motion of body b relative to body a, and their estimates by perturbed queries."""

import numpy as np

from grasp_refine.collision.query import Witness, query
from grasp_refine.core.se3 import cross, exp_so3, matvec, transform
from grasp_refine.witness.scene import WitnessScene
from grasp_refine.witness.slip import wrench


def seen_from_a(
    witness: Witness, force_a: np.ndarray, force_b: np.ndarray, force_n: np.ndarray | None, relative: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Wrenches (batch, pair, 6) on both bodies, from the covector on the relative twist.

    Points and normal first move rigidly with body a, then, in its frame, with the twist of b relative to a:
    dx = V_a(x) + J (xi_b - xi_a) and dn = w_a x n + J_n (xi_b - xi_a). So a common motion never changes a
    relative loss, for any J.

    Args:
        witness: Witness points, world frame.
        force_a: dL/dx_a (batch, pair, 3).
        force_b: dL/dx_b.
        force_n: dL/dn, or None.
        relative: J^T applied to these: a covector on the spatial relative twist (batch, pair, 6).
    """
    wrench_a = wrench(witness.point_a, force_a) + wrench(witness.point_b, force_b) - relative
    if force_n is not None:
        wrench_a[..., 3:] += cross(witness.normal, force_n)
    return wrench_a, relative


def pull_back_differences(
    scene: WitnessScene,
    directions: np.ndarray,
    step: float,
    count: float,
    force_a: np.ndarray,
    force_b: np.ndarray,
    force_n: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Wrenches (batch, pair, 6) on both bodies, from central differences of the query along M relative twists.

    With z_m the directions, the Jacobian is sum_m (x(step z_m) - x(-step z_m)) z_m^T / (2 step count), in which
    perturbations without two answers are left out.

    Args:
        scene: Poses and witness points.
        directions: z (M, 6), without unit, of twists about the witness point of b.
        step: Step as a fraction of the mean diagonal of the two bodies (translations), and in radians (rotations).
        count: Number by which the sum is divided.
        force_a: dL/dx_a (batch, pair, 3).
        force_b: dL/dx_b.
        force_n: dL/dn, or None.
    """
    shape = scene.witness.distance.shape
    scale = step * np.concatenate([np.repeat(scene.length[:, None], 3, axis=1), np.ones((len(scene.length), 3))], 1)
    twists = directions[:, None, None] * scale
    moved = perturbed(scene, np.broadcast_to(np.concatenate([twists, -twists]), (2 * len(directions), *shape, 6)))
    both = moved.valid.reshape(2, -1, *shape).all(axis=0)[..., None]
    local = np.zeros((*shape, 6))
    for points, force in ((moved.point_a, force_a), (moved.point_b, force_b), (moved.normal, force_n)):
        if force is not None:
            forth, back = points.reshape(2, -1, *shape, 3)
            slope = np.einsum("mk,mbpi->kbpi", directions, np.where(both, forth - back, 0.0))
            local += np.einsum("kbpi,bpi->bpk", slope / (2.0 * count * scale.T[:, None, :, None]), force)
    relative = wrench(scene.witness.point_b, local[..., :3])
    relative[..., 3:] += local[..., 3:]
    return seen_from_a(scene.witness, force_a, force_b, force_n, relative)


def perturbed(scene: WitnessScene, twists: np.ndarray) -> Witness:
    """Witness points (M batch, pair, ...) with body b moved by M twists about its witness point x_b.

    The points are relative to x_b, world axes: far from the world origin their differences would be only rounding.

    Args:
        scene: Poses and witness points.
        twists: (M, batch, pair, 6): x_b is moved by the linear part (metres) and the body turned about it by the
            rotation vector (radians), world frame.
    """
    count, batch, pairs, _ = twists.shape
    pivot = scene.witness.point_b
    turn = exp_so3(twists[..., 3:])
    position = matvec(turn, scene.T_world_b[..., :3, 3] - pivot) + twists[..., :3]
    T_b = transform(turn @ scene.T_world_b[..., :3, :3], position).reshape(count * batch, pairs, 4, 4)
    T_a = transform(scene.T_world_a[..., :3, :3], scene.T_world_a[..., :3, 3] - pivot)
    T_a = np.broadcast_to(T_a, (count, batch, pairs, 4, 4)).reshape(count * batch, pairs, 4, 4)
    return query(scene.pairs, T_a, T_b)
