"""Central finite differences of the collision query itself."""

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.arguments import check_positive
from grasp_refine.witness.relative import pull_back_differences
from grasp_refine.witness.scene import WitnessScene


@dataclass(frozen=True)
class FiniteDifference:
    """The slip by central differences: 12 queries with the relative pose moved forth and back along six twists.

    The twists are about the witness point of b.

    Exact, up to the step, where the witness pair moves smoothly; on polytopes that is the slip along the present
    features, or a jump to the neighbouring ones where the step crosses an edge.
    """

    step: float = 1e-3
    """Step as a fraction of the mean diagonal of the two bodies (translations), and in radians (rotations)."""

    def __post_init__(self) -> None:
        """Refuse fields of another type, and numbers out of range."""
        check_positive(self, "step")

    def pull_back(
        self, scene: WitnessScene, force_a: np.ndarray, force_b: np.ndarray, force_n: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Wrenches (batch, pair, 6) on the two bodies from covectors on witness points and normal."""
        return pull_back_differences(scene, np.eye(6), self.step, 1.0, force_a, force_b, force_n)
