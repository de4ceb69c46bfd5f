"""Central finite differences of the collision query itself."""

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.arguments import check_positive
from grasp_refine.witness.perturbation import perturbed, relative_covector
from grasp_refine.witness.relative import seen_from_a
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
        steps = self.step * np.concatenate(
            [np.repeat(scene.length[:, None], 3, axis=1), np.ones((len(scene.length), 3))], 1
        )
        unit = np.eye(6)[:, None, None] * steps
        twists = np.broadcast_to(np.concatenate([unit, -unit]), (12, *scene.witness.distance.shape, 6))
        moved = perturbed(scene, twists)
        shape = (2, 6, *scene.witness.distance.shape)
        both = moved.valid.reshape(shape).all(axis=0)[..., None]
        width = 2.0 * steps.T[:, None, :, None]

        def slope(values: np.ndarray) -> np.ndarray:
            forth, back = values.reshape(*shape, 3)
            return np.where(both, (forth - back) / width, 0.0)

        sensitivity = slope(moved.point_a), slope(moved.point_b), slope(moved.normal)
        relative = relative_covector(scene, sensitivity, force_a, force_b, force_n)
        return seen_from_a(scene.witness, force_a, force_b, force_n, relative)
