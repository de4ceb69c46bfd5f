"""Displacement of a hand between two configurations: one distance for translation, rotation and all joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Float
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.kept import kept


@dataclass(frozen=True, eq=False)
class Displacement:
    """Root mean square displacement of the surface points of a hand, in metres.

    It is the same in every frame of the world, needs no factor between metres and radians, and is a metric. The links
    of an arm do not count.
    """

    chain: Chain
    """Kinematics of the links of the hand with surface points."""
    moments: Float[np.ndarray, "L 4 4"]
    """Second moments (L, 4, 4) of the homogeneous points [p, 1] of each link, link frames, by share of the surface."""

    @staticmethod
    @kept
    def of(hand: Hand) -> Displacement:
        """Return the displacement of a hand."""
        carried = () if hand.arm is None else hand.arm.links
        links = [link for link in hand.links if link.body is not None and link.name not in carried]
        points = [link.solid.candidates for link in links]
        total = sum(float(each.areas.sum()) for each in points)
        moments = np.zeros((len(links), 4, 4))
        for moment, each in zip(moments, points, strict=True):
            homogeneous = np.concatenate([each.points, np.ones((len(each.points), 1))], axis=1)
            moment[:] = np.einsum("k,ki,kj->ij", each.areas / total, homogeneous, homogeneous)
        return Displacement(Chain(hand, [link.name for link in links]), moments)

    def between(
        self,
        T_world_root: Float[np.ndarray, "N 4 4"],
        q: Float[np.ndarray, "N n"],
        T_other: Float[np.ndarray, "N 4 4"],
        q_other: Float[np.ndarray, "N n"],
    ) -> Float[np.ndarray, " N"]:
        """Return the displacement (N,) between two configurations of each hand: root poses and joint values."""
        moved = self.chain(T_other, q_other).T_world_link - self.chain(T_world_root, q).T_world_link
        square = np.einsum("nlij,ljk,nlik->n", moved[:, :, :3], self.moments, moved[:, :, :3])
        return np.sqrt(np.maximum(square, 0.0))
