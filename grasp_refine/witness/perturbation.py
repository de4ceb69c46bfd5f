"""Witness points at perturbed relative poses, for finite differences and zeroth-order smoothing."""

import numpy as np

from grasp_refine.collision.query import Witness, query
from grasp_refine.core.se3 import exp_so3, matvec, transform
from grasp_refine.witness.scene import WitnessScene
from grasp_refine.witness.slip import wrench


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


def relative_covector(
    scene: WitnessScene,
    sensitivity: tuple[np.ndarray, np.ndarray, np.ndarray],
    force_a: np.ndarray,
    force_b: np.ndarray,
    force_n: np.ndarray | None,
) -> np.ndarray:
    """Covector (batch, pair, 6) on the spatial relative twist, from Jacobians about the witness point of b.

    Args:
        scene: Poses and witness points.
        sensitivity: d(x_a, x_b, n) / d twist, each (6, batch, pair, 3), for twists as in `perturbed`.
        force_a: dL/dx_a (batch, pair, 3).
        force_b: dL/dx_b.
        force_n: dL/dn, or None.
    """
    local = sum(
        np.einsum("kbpi,bpi->bpk", jacobian, force)
        for jacobian, force in zip(sensitivity, (force_a, force_b, force_n), strict=True)
        if force is not None
    )
    covector = wrench(scene.witness.point_b, local[..., :3])
    covector[..., 3:] += local[..., 3:]
    return covector
