"""What a grasp should satisfy, one pure function per term, each returning residuals.

A loss is half nothing: it is the plain sum of squared residuals, in square metres. Every function takes torch
tensors and keeps their graph.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from grasp_refine.collision.query import Witness
from grasp_refine.se3 import transform_points


@dataclass(frozen=True)
class Weights:
    """How much each term counts in the sum of squares."""

    contact: float = 1.0
    """Of the contact residuals (metres)."""
    penetration: float = 10.0
    """Of the depth of every link that penetrates the object (metres)."""
    joint_limits: float = 0.01
    """Of the joint values beyond their limits (radians, or metres for prismatic joints); in m^2/rad^2."""


def contact_targets(
    witness: Witness,
    T_world_a: Tensor,
    T_world_b: Tensor,
    target_a: Tensor,
    target_b: Tensor,
    margin: float = 0.0,
) -> Tensor:
    """Contact residuals (..., pair, 7) in metres: gap, and miss of the target on either body.

    r = [d - beta, x_a - t_a, x_b - t_b]. Its square is that of arXiv 2511.06267, Eq. 5, because
    |x_a - x_b + beta n|^2 = (d - beta)^2; written with the signed distance, the gap's gradient is exact and
    needs no smoothing. Zero where a pair has no target (NaN) or no witness points.

    Args:
        witness: Witness points of the contact pairs, world frame.
        T_world_a: Poses (..., pair, 4, 4) of the first bodies.
        T_world_b: Poses of the second bodies.
        target_a: Where body a should be touched (..., pair, 3), its own frame, metres.
        target_b: Where body b should be touched (..., pair, 3), its own frame, metres.
        margin: Contact margin beta in metres: the signed distance that is aimed at.
    """
    valid = torch.as_tensor(witness.valid, device=target_a.device)
    wanted = (valid & ~(target_a.isnan().any(-1) | target_b.isnan().any(-1)))[..., None]
    zero = target_a.new_zeros(())
    gap = torch.where(wanted, witness.distance[..., None], zero + margin) - margin
    miss_a = witness.point_a - transform_points(T_world_a, target_a.nan_to_num())
    miss_b = witness.point_b - transform_points(T_world_b, target_b.nan_to_num())
    return torch.cat([gap, torch.where(wanted, miss_a, zero), torch.where(wanted, miss_b, zero)], dim=-1)


def penetration(witness: Witness) -> Tensor:
    """Penetration depth max(0, -d) (..., pair) in metres; zero where a pair has no witness points."""
    valid = torch.as_tensor(witness.valid, device=witness.distance.device)
    return torch.relu(-torch.where(valid, witness.distance, witness.distance.new_zeros(())))


def joint_limits(q: Tensor, lower: Tensor, upper: Tensor) -> Tensor:
    """How far joint values (..., n) are beyond their limits (n,), in their own unit (rad or m)."""
    return torch.relu(q - upper) + torch.relu(lower - q)
