"""Interface of derivative methods of witness points."""

from typing import Protocol, runtime_checkable

import numpy as np

from grasp_refine.witness.scene import WitnessScene


@runtime_checkable
class Derivative(Protocol):
    """A derivative method: the response of witness points and normals to motions of the two bodies."""

    def pull_back(
        self, scene: WitnessScene, force_a: np.ndarray, force_b: np.ndarray, force_n: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Covectors on the bodies' spatial twists (f, m) (batch, pair, 6): dL = f . v + m . w.

        Args:
            scene: Poses and the witness points found there.
            force_a: dL/dx_a (batch, pair, 3), world frame.
            force_b: dL/dx_b.
            force_n: dL/dn, or None where the loss does not depend on the normal.
        """
        ...
