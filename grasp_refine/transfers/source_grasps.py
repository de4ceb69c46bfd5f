"""Grasps to transfer, whatever hand they are of: contacts of its fingers on the object, and its palm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Bool, Float, Int, Shaped
from grasp_refine.core.short_repr import brief
from grasp_refine.scene.contact_selection import ContactSelection, link_groups
from grasp_refine.scene.hand_object import HandObject
from grasp_refine.scene.scene import Scene
from grasp_refine.transfers.hand_frame import HandFrame, ThumbPlace

INNER_LINK_WEIGHT = 0.3
"""Weight of a contact of an inner link, which the tip of another hand's finger takes over."""


@dataclass(frozen=True, eq=False)
class SourceGrasps:
    """N grasps of a hand with F fingers, the thumb first, then the others from its side on."""

    fingers: tuple[str, ...]
    """Names of the fingers."""
    thumb: ThumbPlace
    """Place of the thumb, as `HandFrame.thumb`."""
    point: Float[np.ndarray, "N F 3"]
    """Contact points (N, F, 3) on the object, object frame, metres; NaN for fingers that do not touch."""
    normal: Float[np.ndarray, "N F 3"]
    """Outward unit normals (N, F, 3) of the object there."""
    weight: Float[np.ndarray, "N F"]
    """Weights (N, F) of the contacts: 1 of fingertips, less of inner links."""
    center: Float[np.ndarray, "N 3"]
    """Centres (N, 3) as `HandFrame.center`, object frame, metres."""
    axes: Float[np.ndarray, "N 3 3"]
    """Axes (N, 3, 3) as `HandFrame.axes`, object frame."""

    __repr__ = brief

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.point)

    @property
    def is_left(self) -> Bool[np.ndarray, " N"]:
        """Mask (N,) of grasps of a left hand, as `HandFrame.is_left`."""
        return np.linalg.det(self.axes) < 0.0 if self.thumb == "side" else np.zeros(len(self), dtype=bool)

    @property
    def touching(self) -> Shaped[np.ndarray, "N F"]:
        """Mask (N, F) of the fingers that touch."""
        return ~np.isnan(self.point[..., 0])


def source_grasps(scene: Scene) -> SourceGrasps:
    """Return the grasps of a scene as grasps to transfer.

    Raises:
        HandError: no joint of the hand moves a link that is meant to touch.
    """
    frame = HandFrame.of(scene.hand)
    R, p = scene.T_world_root[:, :3, :3], scene.T_world_root[:, :3, 3]
    return SourceGrasps(
        frame.fingers,
        frame.thumb,
        *finger_contacts(HandObject.of(scene), scene.number, scene.T_world_root, scene.q),
        center=p + R @ frame.center,
        axes=R @ frame.axes,
    )


def finger_contacts(
    prepared: HandObject,
    number: Int[np.ndarray, " N"],
    T_world_root: Float[np.ndarray, "N 4 4"],
    q: Float[np.ndarray, "N n"],
) -> tuple[Float[np.ndarray, "N F 3"], Float[np.ndarray, "N F 3"], Float[np.ndarray, "N F"]]:
    """Return `point`, `normal` and `weight` of `SourceGrasps` of grasps of a hand.

    A finger touches where its links that should touch (`ContactSelection`) do, at the witness point of the nearest one,
    of fingertips before inner links.

    Args:
        prepared: The hand and the objects.
        number: Index (N,) of each grasp's object.
        T_world_root: Poses (N, 4, 4) of the base link.
        q: Joint values (N, n).
    """
    hand, frame, links = prepared.hand, HandFrame.of(prepared.hand), prepared.chain.links
    witness = prepared.query(number, prepared.chain(T_world_root, q).T_world_link)
    touching = ContactSelection().choose(hand, links, witness)
    groups = np.array(link_groups(hand, links))
    tips = np.isin(links, [contact.link for contact in hand.contacts])
    shape, rows = (len(q), len(frame.fingers)), np.arange(len(q))
    point, normal, weight = np.full((*shape, 3), np.nan), np.full((*shape, 3), np.nan), np.zeros(shape)
    for k, finger in enumerate(frame.fingers):
        of_finger = touching & (groups == finger)
        rank = np.where(of_finger, witness.distance + np.where(tips, 0.0, 1.0), np.inf)
        nearest = rank.argmin(axis=1)
        found = of_finger.any(axis=1)[:, None]
        point[:, k] = np.where(found, witness.point_b[rows, nearest], np.nan)
        normal[:, k] = np.where(found, -witness.normal[rows, nearest], np.nan)
        weight[:, k] = np.where(found[:, 0], np.where(tips[nearest], 1.0, INNER_LINK_WEIGHT), 0.0)
    return point, normal, weight
