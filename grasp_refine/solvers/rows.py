"""Rows of a least-squares problem: residuals with their covectors on the twists of links, stacked."""

from __future__ import annotations

import numpy as np


class Rows:
    """Residuals of M grasps with their covectors on the twists of links, stacked."""

    def __init__(self, count: int) -> None:
        """No rows of `count` grasps yet."""
        self.residuals = [np.zeros((count, 0))]
        self.covectors = [np.zeros((count, 0, 6))]
        self.links = [np.zeros((count, 0), dtype=np.int64)]
        self.minus = [np.zeros((count, 0), dtype=np.int64)]
        self.relative = False

    def add(self, residual: np.ndarray, covector: np.ndarray, weight: float, link: np.ndarray) -> None:
        """Residuals (M, C, k) of the links (C,), with their covectors (M, C, k, 6)."""
        M, C, k = residual.shape
        scale = np.sqrt(weight)
        self.residuals.append(scale * residual.reshape(M, C * k))
        self.covectors.append(scale * covector.reshape(M, C * k, 6))
        self.links.append(np.broadcast_to(np.repeat(link, k), (M, C * k)))
        self.minus.append(np.full((M, C * k), -1))

    def add_active(
        self,
        residual: np.ndarray,
        covector: np.ndarray,
        weight: float,
        link: np.ndarray | None = None,
        minus: np.ndarray | None = None,
    ) -> None:
        """Those of one-sided residuals (M, P) with covectors (M, P, 6) that are not zero, as few rows as hold them."""
        active = residual > 0
        most = int(active.sum(axis=1).max(initial=0))
        if not most:
            return
        place = np.argsort(~active, axis=1, kind="stable")[:, :most]
        chosen = np.take_along_axis(active, place, axis=1)
        scale = np.sqrt(weight)
        self.residuals.append(scale * np.take_along_axis(residual, place, axis=1))
        picked = np.take_along_axis(covector, place[..., None], axis=1)
        self.covectors.append(scale * np.where(chosen[..., None], picked, 0.0))
        self.links.append(place if link is None else link[place])
        self.minus.append(np.full(place.shape, -1) if minus is None else minus[place])
        self.relative |= minus is not None

    def stacked(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
        """Residuals (M, R), covectors (M, R, 6), links (M, R) and, if any, those whose twists are taken off."""
        join = [np.concatenate(parts, axis=1) for parts in (self.residuals, self.covectors, self.links, self.minus)]
        return join[0], join[1], join[2], join[3] if self.relative else None
