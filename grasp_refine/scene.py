"""What is refined: one hand, one object, and grasps."""

from dataclasses import dataclass

import numpy as np

from grasp_refine.hand import Hand
from grasp_refine.objects import Object
from grasp_refine.plane import Plane


@dataclass(frozen=True, eq=False)
class Scene:
    """One hand, one object at the world's origin, and N grasps to refine."""

    hand: Hand
    object: Object
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


def links_of(hand: Hand) -> tuple[str, ...]:
    """Links of a hand with collision geometry; contact links come first, as often as they have contact points."""
    first = [contact.link for contact in hand.contacts]
    return (
        *first,
        *(link.name for link in hand.links if link.body is not None and link.name not in first),
    )
