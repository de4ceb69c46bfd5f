"""Fixed tendons of PhysX: weighted sums of joint values that are held constant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import GraspRefineError

STIFFNESS = 1e5
"""Stiffness of a tendon, N m/rad: the sum of weights and responses is at most 1, so that the solver converges."""

PARALLEL = 1e-3
"""Largest deviation of the cosine between parallel axes from 1."""


@dataclass(frozen=True, eq=False)
class Tendon:
    """Sum of joint values times weights that is constant."""

    links: tuple[int, ...]
    """Links that it runs along, each after its parent; the first is the root, whose joint does not count."""
    weights: Float[np.ndarray, " k"]
    """Weights (k,) of the joints of these links; 0 for the root's."""
    responses: Float[np.ndarray, " k"]
    """Torques or forces (k,) on these links, along the axes of their joints, under unit tension."""
    length: float
    """Sum, rad or m."""

    @staticmethod
    def of(
        terms: Mapping[int, float],
        length: float,
        parents: Sequence[int],
        axes: Float[np.ndarray, "l 6"],
        name: str,
    ) -> Tendon:
        """Return the tendon that holds a sum of joint values constant.

        PhysX pulls each link of a tendon by an outer torque (or force) along the x axis of the link, with the reaction
        at the root. So the torque at a joint is that on its link, and on all links above it, whose axes are parallel.
        Responses are such that this is the joint's weight times the tension, by virtual work; from the tips on,
        response = weight - sum of (u_joint . u_above) response_above.

        Args:
            terms: Weight of each joint, by the number of its link.
            length: The sum, in rad or m.
            parents: Number of the parent of each of the l links.
            axes: Directions (l, 6) of the joints' axes in one frame: first of sliding joints, then of hinges.
            name: Name of the tendon, or of the joint that is coupled.

        Raises:
            GraspRefineError: the axes along the tendon are not parallel.
        """
        root = common_parent(list(terms), parents)
        links = sorted({link for leaf in terms for link in _line(leaf, parents)[_line(leaf, parents).index(root) :]})
        if not np.allclose(np.abs(axes[links[1:]] @ axes[links[1]]), 1.0, atol=PARALLEL):
            raise GraspRefineError(
                f"engine physx couples joints with parallel axes, and those of '{name}' are not: use engine mujoco or "
                f"drake"
            )
        responses: dict[int, float] = {}
        for link in reversed(links[1:]):
            above = sum(
                axes[link] @ axes[other] * response
                for other, response in responses.items()
                if link in _line(other, parents)
            )
            responses[link] = terms.get(link, 0.0) - float(above)
        weights = np.array([0.0] + [terms.get(link, 0.0) for link in links[1:]])
        pulls = np.array([0.0] + [responses[link] for link in links[1:]])
        scale = max(np.abs(weights).max(), np.abs(pulls).max(), np.sqrt(np.abs(weights * pulls).sum()))
        return Tendon(tuple(links), weights / scale, pulls / scale, length / scale)


def common_parent(links: Sequence[int], parents: Sequence[int]) -> int:
    """Return the last link that all of some links hang on."""
    above = [_line(link, parents)[:-1] for link in links]
    return max(set(above[0]).intersection(*above), key=above[0].index)


def first_below(root: int, link: int, parents: Sequence[int]) -> int:
    """Return the link that hangs on `root`, and on which `link` hangs, or that link itself."""
    line = _line(link, parents)
    return line[line.index(root) + 1]


def _line(link: int, parents: Sequence[int]) -> list[int]:
    """Return the links from the base to a link."""
    line = [link]
    while parents[line[0]] >= 0:
        line.insert(0, parents[line[0]])
    return line
