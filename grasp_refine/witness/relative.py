"""Derivatives from the motion of body b relative to body a."""

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.se3 import cross
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
