"""Rows of a least-squares problem: residuals with their derivatives, stacked."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from grasp_refine.core.short_repr import brief
from grasp_refine.hands.chain import Chain, Frames

NEAR_DISTANCE_M = 0.006
"""Bodies nearer than this (metres) may penetrate within a step and have a row."""


@dataclass(frozen=True, eq=False)
class Linear:
    """Residuals of members and their derivatives."""

    residual: np.ndarray
    """Residuals (batch, m) that have a derivative."""
    jacobian: np.ndarray
    """Derivatives (batch, m, dof) of the residuals in the unknowns of a step."""
    unilateral: np.ndarray | None = None
    """Rows (batch, m) that count only where they are positive; None: none."""

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class LinkRows:
    """Residuals (M, R) of M grasps whose derivatives are linear in the twists of links."""

    residual: np.ndarray
    """Residuals (M, R)."""
    covector: np.ndarray
    """Covectors (M, R, 6): the residual changes by covector . (v, w), the spatial twist of its link."""
    link: np.ndarray
    """Index of each row's link, (R,) or (M, R)."""
    minus: np.ndarray | None = None
    """Index of the link whose twist is subtracted, likewise; None: none."""
    unilateral: bool = False
    """Whether they count only where they are positive."""

    @staticmethod
    def of(residual: np.ndarray, covector: np.ndarray, link: np.ndarray) -> LinkRows:
        """Return rows of residuals (M, C, k) of the links (C,), with their covectors (M, C, k, 6)."""
        M, C, k = residual.shape
        return LinkRows(residual.reshape(M, C * k), covector.reshape(M, C * k, 6), np.repeat(link, k))

    @staticmethod
    def near(
        depth: np.ndarray, covector: np.ndarray, link: np.ndarray | None = None, minus: np.ndarray | None = None
    ) -> LinkRows:
        """Return depths (M, P) with covectors (M, P, 6) that count where positive, in as few rows as needed.

        Args:
            depth: Depths in metres; negative: distance that is left; -inf where there is no row.
            covector: Their covectors on the twists of the links.
            link: Indices (P,) or (M, P) of the links; None: 0 to P - 1.
            minus: Indices (P,) of the links whose twists are subtracted.
        """
        near = depth > -NEAR_DISTANCE_M
        place = np.argsort(~near, axis=1, kind="stable")[:, : int(near.sum(axis=1).max(initial=0))]
        at = np.arange(len(place))[:, None], place
        chosen = near[at]
        residual = np.where(chosen, depth[at], -NEAR_DISTANCE_M)
        covector = np.where(chosen[..., None], covector[at], 0.0)
        first = None if link is None else np.broadcast_to(link, depth.shape)[at]
        second = None if minus is None else minus[place]
        return LinkRows(residual, covector, place if first is None else first, second, unilateral=True)


@dataclass(frozen=True, eq=False)
class JointRows:
    """Residuals (M, R) of M grasps with their derivatives (M, R, 6 + n) in root twist and joint values."""

    residual: np.ndarray
    jacobian: np.ndarray


def stack(rows: Iterable[tuple[float, LinkRows | JointRows]], count: int, chain: Chain, frames: Frames) -> Linear:
    """Return all rows of `count` grasps, weighted by their squares, in root twist and joint values; links' rows first.

    Args:
        rows: Weights with their rows; a weight multiplies the squares.
        count: Number of grasps.
        chain: Kinematics of the links.
        frames: Poses of the links.
    """
    none = LinkRows(np.zeros((count, 0)), np.zeros((count, 0, 6)), np.zeros(0, dtype=np.int64))
    of_links: list[tuple[float, LinkRows]] = [(1.0, none)]
    of_joints: list[tuple[float, JointRows]] = []
    for weight, part in rows:
        if not part.residual.shape[1]:
            continue
        if isinstance(part, LinkRows):
            of_links.append((weight, part))
        else:
            of_joints.append((weight, part))

    def joined(values: list[np.ndarray]) -> np.ndarray:
        return np.concatenate(values, axis=1)

    covector = joined([np.sqrt(weight) * part.covector for weight, part in of_links])
    link = joined([np.broadcast_to(part.link, part.residual.shape) for _, part in of_links])
    J = chain.to_joint_space(frames, covector, link)
    end = np.cumsum([part.residual.shape[1] for _, part in of_links])
    for (_, part), stop in zip(of_links, end.tolist(), strict=True):
        if part.minus is not None:
            columns = slice(stop - part.residual.shape[1], stop)
            J[:, columns] -= chain.to_joint_space(frames, covector[:, columns], part.minus)
    parts: list[tuple[float, LinkRows | JointRows]] = [*of_links, *of_joints]
    one_sided = [np.full(part.residual.shape, isinstance(part, LinkRows) and part.unilateral) for _, part in parts]
    unilateral = joined(one_sided)
    return Linear(
        joined([np.sqrt(weight) * part.residual for weight, part in parts]),
        joined([J, *(np.sqrt(weight) * part.jacobian for weight, part in of_joints)]),
        unilateral if unilateral.any() else None,
    )
