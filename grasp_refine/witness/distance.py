"""Distance-based randomized smoothing of witness points (arXiv 2511.06267, section IV)."""

from dataclasses import dataclass, field, replace

import numpy as np

from grasp_refine.core.arguments import check_fields
from grasp_refine.core.se3 import transform_points
from grasp_refine.witness.neighborhood import Adaptive, Fixed, Neighbors
from grasp_refine.witness.rings import Neighbor
from grasp_refine.witness.scene import WitnessScene
from grasp_refine.witness.slip import Coupling, Slip, SlipMethod


@dataclass(frozen=True)
class Distance(SlipMethod):
    """The closest point as a soft minimum, over nearby surface samples v_j, of the distance to the other point y.

    w_j = softmax(-|v_j - y|^2 / tau), x* = sum w_j v_j, hence dx*/dy = (2 / tau) Cov_w(v).
    Held fixed: the samples, tau (the spread of the scores) and, in the one-sided coupling, the other witness
    point. Approximated: the surface by its samples. Exact: everything that follows from rigid motion.
    """

    neighborhood: Adaptive | Fixed | Neighbor = field(default_factory=Adaptive)
    """Choice of the surface samples near a witness point."""
    coupling: Coupling = "coupled"
    """Solve both slips together, or hold the other witness point fixed as in the paper."""
    smoothed_self: bool = False
    """Whether the self term moves the smoothed point x* instead of the witness point."""
    seed: int = 0
    """Seed of the random choice of samples."""

    def __post_init__(self) -> None:
        """Refuse settings of other types."""
        check_fields(self)

    def slip(self, scene: WitnessScene) -> Slip:
        """Slip matrices (batch, pair, 3, 3) of both bodies, world frame."""
        sides, near = scene.neighbors(self.neighborhood, self.seed)
        smoothed, slip = smooth(near, sides.other)
        found = Slip.of_sides(scene, sides, slip)
        if not self.smoothed_self:
            return found
        self_a, self_b = np.split(smoothed.swapaxes(0, 1), 2, axis=1)
        return replace(
            found,
            self_a=transform_points(scene.T_world_a, self_a),
            self_b=transform_points(scene.T_world_b, self_b),
        )


def smooth(near: Neighbors, y: np.ndarray, tau: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the smoothed closest point to y and its derivative.

    Args:
        near: Surface samples (S, B, K, 3), body frames.
        y: The other witness point (S, B, 3), body frames, metres.
        tau: Temperature (S, B) in square metres; by default the `temperature` of the scores.

    Returns:
        x* = sum w_j v_j (S, B, 3), and dx*/dy = (2 / tau) Cov_w(v) (S, B, 3, 3) with samples and tau held fixed.
    """
    scores = scores_of(near, y)
    tau = temperature(near, scores) if tau is None else tau
    scores = np.where(near.mask, scores, -np.inf)
    weights = np.exp((scores - scores.max(axis=2, keepdims=True)) / tau[..., None])
    weights /= weights.sum(axis=2, keepdims=True)
    smoothed = (weights[..., None, :] @ near.points)[..., 0, :]
    centered = near.points - smoothed[..., None, :]
    covariance = (weights[..., None] * centered).mT @ centered
    return smoothed, covariance * (2.0 / tau)[..., None, None]


def temperature(near: Neighbors, scores: np.ndarray) -> np.ndarray:
    """Tau (S, B): the standard deviation of the scores over the samples, floored, in square metres."""
    count = near.mask.sum(axis=2)
    mean = (scores * near.mask).sum(axis=2) / count
    deviation = (scores - mean[..., None]) * near.mask
    return np.maximum(np.sqrt((deviation * deviation).sum(axis=2) / count), near.floor)


def scores_of(near: Neighbors, y: np.ndarray) -> np.ndarray:
    """Scores -|v_j - y|^2 (S, B, K) of the samples, in square metres."""
    offset = near.points - y[..., None, :]
    return -np.einsum("sbki,sbki->sbk", offset, offset)
