"""Rows of a least-squares problem: residuals with their covectors on the twists of links, stacked."""

from __future__ import annotations

import numpy as np

from grasp_refine.hands.chain import Chain, Frames
from grasp_refine.refinement.solvers.least_squares import Linear

NEAR_DISTANCE_M = 0.006
"""Bodies nearer than this (metres) may penetrate within a step and have a row."""


class Rows:
    """Residuals of M grasps with their covectors on the twists of links, stacked."""

    def __init__(self, count: int) -> None:
        """Begin without rows, for `count` grasps."""
        self.residuals = [np.zeros((count, 0))]
        self.covectors = [np.zeros((count, 0, 6))]
        self.links = [np.zeros((count, 0), dtype=np.int64)]
        self.minus = [np.zeros((count, 0), dtype=np.int64)]
        self.unilateral = [np.zeros((count, 0), dtype=bool)]
        self.relative = False

    def add(self, residual: np.ndarray, covector: np.ndarray, weight: float, link: np.ndarray) -> None:
        """Add residuals (M, C, k) of the links (C,), with their covectors (M, C, k, 6)."""
        M, C, k = residual.shape
        scale = np.sqrt(weight)
        self.residuals.append(scale * residual.reshape(M, C * k))
        self.covectors.append(scale * covector.reshape(M, C * k, 6))
        self.links.append(np.broadcast_to(np.repeat(link, k), (M, C * k)))
        self.minus.append(np.full((M, C * k), -1))
        self.unilateral.append(np.zeros((M, C * k), dtype=bool))

    def add_unilateral(
        self,
        depth: np.ndarray,
        covector: np.ndarray,
        weight: float,
        link: np.ndarray | None = None,
        minus: np.ndarray | None = None,
    ) -> None:
        """Add depths (M, P) with covectors (M, P, 6) that count where positive, in as few rows as the near ones need.

        Args:
            depth: Depths in metres; negative: distance that is left; -inf where there is no row.
            covector: Their covectors on the twists of the links.
            weight: Weight of their squares.
            link: Indices (P,) of the links; None: 0 to P - 1.
            minus: Indices (P,) of the links whose twists are subtracted.
        """
        near = depth > -NEAR_DISTANCE_M
        most = int(near.sum(axis=1).max(initial=0))
        if not most:
            return
        place = np.argsort(~near, axis=1, kind="stable")[:, :most]
        chosen = np.take_along_axis(near, place, axis=1)
        scale = np.sqrt(weight)
        picked = np.take_along_axis(depth, place, axis=1)
        self.residuals.append(scale * np.where(chosen, picked, -NEAR_DISTANCE_M))
        picked = np.take_along_axis(covector, place[..., None], axis=1)
        self.covectors.append(scale * np.where(chosen[..., None], picked, 0.0))
        self.links.append(place if link is None else link[place])
        self.minus.append(np.full(place.shape, -1) if minus is None else minus[place])
        self.unilateral.append(np.ones(place.shape, dtype=bool))
        self.relative |= minus is not None

    def joint_covectors(self, chain: Chain, frames: Frames) -> Linear:
        """Return all rows as functions of root twist and joint values."""
        parts = self.residuals, self.covectors, self.links, self.minus, self.unilateral
        residual, covector, link, minus, unilateral = (np.concatenate(part, axis=1) for part in parts)
        J = chain.to_joint_space(frames, covector, link)
        if self.relative:
            J -= chain.to_joint_space(frames, np.where(minus[..., None] >= 0, covector, 0.0), np.maximum(minus, 0))
        return Linear(residual, J, unilateral if unilateral.any() else None)
