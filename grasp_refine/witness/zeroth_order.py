"""Zeroth-order randomized smoothing (RS-0): the query averaged over Gaussian perturbations of the relative pose."""

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.arguments import check_positive
from grasp_refine.witness.perturbation import perturbed, relative_covector
from grasp_refine.witness.relative import seen_from_a
from grasp_refine.witness.scene import WitnessScene


@dataclass(frozen=True)
class ZerothOrder:
    """Slip of witness points smoothed over random relative poses, by two queries a sample.

    The gradient of E[x(sigma z)], z ~ N(0, I_6), is estimated as the mean of (x(sigma z) - x(-sigma z)) z / (2 sigma).

    Antithetic pairs; unbiased for the smoothed points, with a variance that falls as 1 / samples. The
    perturbations depend on the seed and the iteration only, and are the same for all items of a batch.
    """

    sigma: float = 1e-2
    """Spread as a fraction of the mean diagonal of the two bodies (translations), and in radians (rotations)."""
    samples: int = 8
    """Number of antithetic pairs; each takes two queries."""
    seed: int = 0
    """Seed of the perturbations."""

    def __post_init__(self) -> None:
        """Refuse fields of another type, and numbers out of range."""
        check_positive(self, "sigma", "samples")

    def pull_back(
        self, scene: WitnessScene, force_a: np.ndarray, force_b: np.ndarray, force_n: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Wrenches (batch, pair, 6) on the two bodies from covectors on witness points and normal."""
        z = np.random.default_rng((self.seed, scene.key)).standard_normal((self.samples, 6))
        scale = self.sigma * np.concatenate(
            [np.repeat(scene.length[:, None], 3, axis=1), np.ones((len(scene.length), 3))], 1
        )
        shape = (2, self.samples, *scene.witness.distance.shape)
        signed = np.concatenate([z, -z])[:, None, None] * scale
        moved = perturbed(scene, np.broadcast_to(signed, (2 * self.samples, *scene.witness.distance.shape, 6)))
        both = moved.valid.reshape(shape).all(axis=0)[..., None]

        def slope(values: np.ndarray) -> np.ndarray:
            forth, back = values.reshape(*shape, 3)
            difference = np.where(both, forth - back, 0.0)
            return np.einsum("mk,mbpi->kbpi", z, difference) / (2.0 * self.samples * scale.T[:, None, :, None])

        sensitivity = slope(moved.point_a), slope(moved.point_b), slope(moved.normal)
        relative = relative_covector(scene, sensitivity, force_a, force_b, force_n)
        return seen_from_a(scene.witness, force_a, force_b, force_n, relative)
