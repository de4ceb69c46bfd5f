"""What is refined: one hand, one object, and grasps."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool

from grasp_refine.hand import Hand
from grasp_refine.objects import Object
from grasp_refine.plane import Plane

FARTHEST = 1e6
"""Poses, joint values and targets beyond this, in metres or radians, are refused: no grasp is there, and further out
squares overflow."""

SKEWED = 1e-3
"""How far R^T R may be from the identity, and a wanted normal from unit length: rounding passes, a mix-up does not."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One hand, one object at the world's origin, and N grasps to refine."""

    hand: Hand
    """What grasps."""
    object: Object
    """What is grasped; it rests at the identity."""
    T_world_root: np.ndarray
    """Initial poses (N, 4, 4) of the hand's base link in the object's frame, metres."""
    q: np.ndarray
    """Initial joint values (N, n) in `hand.joint_names` order."""
    target_link: np.ndarray | None = None
    """Where links should touch (N, L, 3), link frames, one column per link of `links`; NaN: nowhere. None: auto."""
    target_object: np.ndarray | None = None
    """Where the object should be touched (N, L, 3), object frame, metres."""
    direction: np.ndarray | None = None
    """Wanted contact normals from link to object (N, L, 3), object frame, unit length; NaN: any."""
    table: Plane | None = None
    """A plane that no link may go through."""

    @property
    def links(self) -> tuple[str, ...]:
        """Links with collision geometry, the columns of every per-link array."""
        return links_of(self.hand)

    @property
    def finite(self) -> Bool[np.ndarray, " N"]:
        """Which grasps (N,) have poses and joint values that are numbers."""
        return np.isfinite(self.T_world_root).all(axis=(1, 2)) & np.isfinite(self.q).all(axis=1)

    @property
    def posed(self) -> Bool[np.ndarray, " N"]:
        """Which grasps (N,) are somewhere: poses are rigid, and poses and joint values within `FARTHEST`."""
        near = self.finite & (np.abs(self.T_world_root) <= FARTHEST).all(axis=(1, 2))
        T = np.where(near[:, None, None], self.T_world_root, np.eye(4))
        R = T[:, :3, :3]
        skewed = np.abs(R.mT @ R - np.eye(3)).max(axis=(1, 2), initial=0.0)
        rigid = (skewed <= SKEWED) & (np.linalg.det(R) > 0) & (T[:, 3] == [0, 0, 0, 1]).all(axis=1)
        return near & rigid & (np.abs(self.q) <= FARTHEST).all(axis=1)

    @property
    def sound(self) -> Bool[np.ndarray, " N"]:
        """Which grasps (N,) can be refined: those whose targets are within `FARTHEST` too, and wanted normals units."""
        sound = self.posed
        for target in (self.target_link, self.target_object):
            if target is not None:
                sound &= ~(np.abs(target) > FARTHEST).any(axis=(1, 2))
        if self.direction is not None:
            squared = (np.clip(self.direction, -2.0, 2.0) ** 2).sum(axis=-1)
            sound &= ((np.abs(squared - 1.0) <= SKEWED) | np.isnan(self.direction).all(axis=-1)).all(axis=1)
        return sound

    def masked(self, rows: Bool[np.ndarray, " N"]) -> "Scene":
        """The same scene with NaN for all numbers of the grasps where `rows` (N,) does not hold."""
        if rows.all():
            return self

        def kept(values: np.ndarray | None) -> np.ndarray | None:
            return None if values is None else np.where(rows.reshape(-1, *(1,) * (values.ndim - 1)), values, np.nan)

        names = ("T_world_root", "q", "target_link", "target_object", "direction")
        arrays: dict[str, Any] = {name: kept(getattr(self, name)) for name in names}
        return replace(self, **arrays)


def links_of(hand: Hand) -> tuple[str, ...]:
    """Links of a hand with collision geometry; contact links come first, as often as they have contact points."""
    first = [contact.link for contact in hand.contacts]
    return (
        *first,
        *(link.name for link in hand.links if link.body is not None and link.name not in first),
    )
