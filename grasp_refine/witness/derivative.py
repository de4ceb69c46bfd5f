"""Interface of derivative methods of witness points."""

from collections.abc import Sequence
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


@runtime_checkable
class PoseGradients(Protocol):
    """A derivative method that can do the whole backward pass of the witness layer in one compiled call."""

    def pose_gradients(
        self, scene: WitnessScene, cotangents: Sequence[np.ndarray | None]
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Gradients (batch, pair, 4, 4) in the entries of both poses, as `se3.ambient_gradient`; None: not compiled.

        Args:
            scene: Poses and the witness points found there; where there are none, the gradients are zero.
            cotangents: dL/dx_a, dL/dx_b, dL/dn (batch, pair, 3) and dL/dd (batch, pair), or None for each.
        """
        ...
