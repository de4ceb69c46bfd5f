"""Direction-based randomized smoothing of witness points (Montaut et al. 2022, arXiv 2209.09012)."""

from dataclasses import dataclass, field

import numpy as np

from grasp_refine.core.arguments import check_positive
from grasp_refine.witness.neighborhood import Adaptive, Fixed
from grasp_refine.witness.rings import Neighbor
from grasp_refine.witness.scene import WitnessScene
from grasp_refine.witness.slip import Coupling, Slip, SlipMethod


@dataclass(frozen=True)
class Direction(SlipMethod):
    """The witness point as a soft support point of nearby samples v_j in the direction of the other one.

    w_j = softmax(<v_j, s (x_b - x_a)> / eps), s = +1 separated and -1 penetrating. With C = Cov_w(v) / eps the
    support point follows its direction by C, hence A = (I + s C)^-1 s C. Held fixed: the samples and eps. Blind
    spot: the scores vanish with the gap, so that close to contact all samples weigh the same. Direction and gap are
    taken from the contact normal and the distance, because the difference of two points far from the world origin
    is only rounding.
    """

    neighborhood: Adaptive | Fixed | Neighbor = field(default_factory=Adaptive)
    """Choice of the surface samples near a witness point."""
    coupling: Coupling = "coupled"
    """Solve both slips together, or hold the other witness point fixed."""
    epsilon: float | None = None
    """Temperature eps over the squared mean diagonal of the two bodies; None: the standard deviation of the scores."""
    seed: int = 0
    """Seed of the random choice of samples."""

    def __post_init__(self) -> None:
        """Refuse fields of another type, and numbers out of range."""
        check_positive(self, "epsilon")

    def slip(self, scene: WitnessScene) -> Slip:
        """Slip matrices (batch, pair, 3, 3) of both bodies, world frame."""
        sides, near = scene.neighbors(self.neighborhood, self.seed)
        distance = scene.witness.distance
        distance = np.concatenate([distance, distance], axis=1).T
        sign = np.where(distance > 0, 1.0, -1.0)
        direction = np.abs(distance)[..., None] * sides.normal
        scores = (near.points @ direction[..., None])[..., 0]
        count = near.mask.sum(axis=2)
        if self.epsilon is None:
            mean = (scores * near.mask).sum(axis=2) / count
            spread = np.sqrt((((scores - mean[..., None]) * near.mask) ** 2).sum(axis=2) / count)
            # Scores are at most |x_b - x_a| times the spread of the samples; rounding bounds them from below.
            eps = np.maximum(spread, np.finfo(np.float64).eps * near.floor)
        else:
            squared = np.tile(scene.length**2, 2)[:, None]
            eps = np.broadcast_to(self.epsilon * squared, scores.shape[:2])
        scores = np.where(near.mask, scores, -np.inf)
        weights = np.exp((scores - scores.max(axis=2, keepdims=True)) / eps[..., None])
        weights /= weights.sum(axis=2, keepdims=True)
        centered = near.points - weights[..., None, :] @ near.points
        C = (weights[..., None] * centered).mT @ centered * (sign / eps)[..., None, None]
        # (I + s C)^-1 s C on the eigenvectors of C; -1 is a pole that occurs only in penetration.
        values, vectors = np.linalg.eigh(C)
        away = np.where(
            np.abs(1.0 + values) < _MIN_POLE_DISTANCE, np.copysign(_MIN_POLE_DISTANCE, 1.0 + values), 1.0 + values
        )
        slip = (vectors * (values / away)[..., None, :]) @ vectors.mT
        return Slip.of_sides(scene, sides, slip)


_MIN_POLE_DISTANCE = 1e-3
"""Smallest distance of 1 + eigenvalue from zero."""
