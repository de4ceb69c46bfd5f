"""The naive baseline: witness points frozen to their bodies."""

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.se3 import cross
from grasp_refine.witness.scene import WitnessScene
from grasp_refine.witness.slip import wrench


@dataclass(frozen=True)
class Rigid:
    """No slip: each witness point moves with its body, and the normal turns with the mean of both.

    dx_a = V_a(x_a), dx_b = V_b(x_b), dn = (w_a + w_b) / 2 x n.

    Exact for the signed distance and for a vertex against a vertex only.
    """

    def pull_back(
        self, scene: WitnessScene, force_a: np.ndarray, force_b: np.ndarray, force_n: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Wrenches (batch, pair, 6) on the two bodies from covectors on witness points and normal."""
        w = scene.witness
        wrench_a, wrench_b = wrench(w.point_a, force_a), wrench(w.point_b, force_b)
        if force_n is not None:
            moment = 0.5 * cross(w.normal, force_n)
            wrench_a[..., 3:] += moment
            wrench_b[..., 3:] += moment
        return wrench_a, wrench_b
