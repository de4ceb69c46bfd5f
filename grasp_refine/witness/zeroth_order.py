"""Zeroth-order randomized smoothing (RS-0): the query averaged over Gaussian perturbations of the relative pose."""

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.arguments import check_positive
from grasp_refine.witness.relative import pull_back_differences
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
        return pull_back_differences(scene, z, self.sigma, self.samples, force_a, force_b, force_n)
