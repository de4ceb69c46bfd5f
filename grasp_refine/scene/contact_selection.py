"""Selection of the links that should touch the object, and of their contact points, where none are given."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.arguments import check_fields
from grasp_refine.core.array_types import Bool, Float, Int
from grasp_refine.core.errors import GraspRefineError, HandError, did_you_mean
from grasp_refine.core.se3 import inverse, transform_points
from grasp_refine.hands.hand import Hand
from grasp_refine.objects.region import ContactRegions

CONTACT_DISTANCE_M = 0.002
"""Signed distance in metres within which a link counts as touching."""

FLUSH_M = 5e-4
"""Difference of signed distances in metres up to which links that are fixed to each other touch together."""

PALM = "palm"
"""Group of the links that carry several fingers, or none."""


@dataclass(frozen=True)
class ContactSelection:
    """Selection of the contact links of a grasp: links near the object at its start."""

    reach: float = 0.01
    """Contact links (fingertips) within this signed distance of the object touch it, in metres; of links fixed to each
    other, where the program chose them, only the nearest, and links flush with it."""
    other_link_distance: float = 0.003
    """All other links within this signed distance of the object touch it, in metres; links of linkages that give way
    (`Hand.yielding`) do not, nor does the palm of a hand with two fingers, which does not press."""
    farthest: float = 0.03
    """Distance up to which the nearest contact links count where fewer than two groups (fingers, palm) are in reach."""
    links: tuple[str, ...] = ()
    """Links that touch, instead of the links near the object. The name of a finger means its contact links."""

    def __post_init__(self) -> None:
        """Refuse invalid distances.

        Raises:
            GraspRefineError: a distance below zero, or links that are not a tuple of names.
        """
        check_fields(self)
        for name in ("reach", "other_link_distance", "farthest"):
            if not getattr(self, name) >= 0:
                raise GraspRefineError(f"{name} must be a distance of at least 0 m, got {getattr(self, name):g}")

    def named(self, hand: Hand, links: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of `links` that `self.links` lists, fingers replaced by their contact links.

        Args:
            hand: The hand.
            links: Links with collision geometry.

        Raises:
            HandError: a name is neither one of them nor a finger.
        """
        fingers: dict[str, list[str]] = {}
        for contact in hand.contacts:
            fingers.setdefault(contact.group, []).append(contact.link)
        # A link takes precedence over a finger of the same name.
        meant = [[name] if name in links else fingers.get(name, []) for name in self.links]
        unknown = [name for name, found in zip(self.links, meant, strict=True) if not found]
        if unknown:
            raise HandError(
                f"hand {hand.name} has neither a finger nor a link with collision geometry called "
                f"{', '.join(unknown)}{did_you_mean(unknown[0], [*fingers, *links])} its fingers are "
                f"{', '.join(fingers)}, its links {', '.join(dict.fromkeys(links))}"
            )
        return tuple(dict.fromkeys(link for found in meant for link in found))

    def cutoff(self, hand: Hand, links: tuple[str, ...]) -> np.ndarray:
        """Distance of each link (L,) in metres beyond which it cannot touch: the cutoff of a query.

        Raises:
            HandError: a named link or finger does not exist.
        """
        if self.links:
            return np.where(np.isin(links, self.named(hand, links)), np.inf, -np.inf)
        tips = np.isin(links, [contact.link for contact in hand.contacts])
        # Links exactly at the limit are queried.
        return np.nextafter(np.where(tips, max(self.reach, self.farthest), self.other_link_distance), np.inf)

    def choose(self, hand: Hand, links: tuple[str, ...], witness: Witness) -> np.ndarray:
        """Mask (N, L) of the links that should touch, none of them twice.

        Args:
            hand: The hand.
            links: Links with collision geometry, contact links first; one may be listed several times.
            witness: Witness points (N, L) of links and object, for pairs below `cutoff`.
        """
        first = np.array([links.index(link) == column for column, link in enumerate(links)])
        distance = np.where(witness.valid & first, witness.distance, np.inf)
        if self.links:
            return np.isfinite(distance) & np.isin(links, self.named(hand, links))
        tips = np.isin(links, [contact.link for contact in hand.contacts])
        if hand.contacts_guessed:
            distance = _nearest_of_fixed(hand, links, distance, tips)
        unfit = hand.yielding if hand.arm is None else hand.yielding | hand.arm.links
        if hand.has_two_fingers:
            unfit |= hand.fixed_to(hand.palm)
        firm = tips | ~np.isin(links, list(unfit))
        touching = (distance <= np.where(tips, self.reach, self.other_link_distance)) & firm
        group = np.unique(link_groups(hand, links), return_inverse=True)[1]
        for row in np.flatnonzero(touching.any(axis=1) | (distance <= self.farthest).any(axis=1)):
            for column in np.argsort(distance[row], kind="stable"):
                if len(np.unique(group[touching[row]])) >= 2 or distance[row, column] > self.farthest:
                    break
                touching[row, column] |= tips[column] and group[column] not in group[touching[row]]
        return touching

    def choose_within(
        self, hand: Hand, links: tuple[str, ...], witness: Witness, regions: ContactRegions | None
    ) -> np.ndarray:
        """Mask (N, L) as of `choose`, of links that are in the regions, or nearer to them than their reach.

        Where these are of fewer than two groups, links count wherever they are.

        Args:
            hand: The hand.
            links: As there.
            witness: As there, in the object's frame.
            regions: Regions in which links should touch; None: everywhere.
        """
        anywhere = self.choose(hand, links, witness)
        if regions is None or self.links:
            return anywhere
        miss = np.where(witness.valid, regions.miss(witness.point_b), 0.0)
        within = self.choose(hand, links, replace(witness, distance=witness.distance + miss))
        return np.where((num_groups(hand, links, within) >= 2)[:, None], within, anywhere)


def _nearest_of_fixed(
    hand: Hand, links: Sequence[str], distance: Float[np.ndarray, "N L"], tips: Bool[np.ndarray, " L"]
) -> Float[np.ndarray, "N L"]:
    """Return distances (N, L) that are infinite for contact links behind another one that is fixed to them."""
    part = np.where(tips, [hand.parts_of_links[link] for link in links], "")
    found = distance.copy()
    for one in set(part[tips]):
        columns = np.flatnonzero(part == one)
        if len(columns) > 1:
            own = distance[:, columns]
            found[:, columns] = np.where(own <= own.min(axis=1, keepdims=True) + FLUSH_M, own, np.inf)
    return found


def link_groups(hand: Hand, links: tuple[str, ...]) -> list[str]:
    """The group of each link: of its finger, if it is part of exactly one, else `PALM`."""
    group = {contact.link: contact.group for contact in hand.contacts}
    parent = {joint.child: joint.parent for joint in hand.joints}
    carried: dict[str, set[str]] = {}
    for contact in hand.contacts:
        link: str | None = contact.link
        while link is not None:
            carried.setdefault(link, set()).add(contact.group)
            link = parent.get(link)

    def of(link: str) -> str:
        if link in group:
            return group[link]
        fingers = carried.get(link, set())
        return next(iter(fingers)) if len(fingers) == 1 else PALM

    return [of(link) for link in links]


def num_groups(hand: Hand, links: tuple[str, ...], touching: Bool[np.ndarray, "N L"]) -> Int[np.ndarray, " N"]:
    """Return the number (N,) of the groups (fingers, palm) with links (N, L) that touch."""
    group = np.unique(link_groups(hand, links), return_inverse=True)[1]
    return np.stack([touching[:, group == one].any(axis=1) for one in range(group.max() + 1)]).sum(axis=0)


def contact_misses(regions: ContactRegions, witness: Witness) -> np.ndarray:
    """Return how far (N, L) in metres links that touch the object do so outside of regions; 0 for others.

    Args:
        regions: Regions in which they should touch.
        witness: Witness points (N, L) of links and object, object frame.
    """
    touches = witness.valid & (witness.distance <= CONTACT_DISTANCE_M)
    found = np.zeros(touches.shape)
    found[touches] = regions.miss(witness.point_b[touches])
    return found


def nearest_points(
    witness: Witness, T_world_a: np.ndarray, T_world_b: np.ndarray, touching: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The current witness points of the links that should touch, in the bodies' frames, as targets.

    Args:
        witness: Witness points of links (a) and object (b).
        T_world_a: Poses of the links (batch, pair, 4, 4).
        T_world_b: Poses of the object (batch, pair, 4, 4).
        touching: Links (batch, pair) that should touch.

    Returns:
        Points on the links and on the object (batch, pair, 3) in metres, NaN for other links.
    """
    wanted = touching[..., None]
    on_a = transform_points(inverse(T_world_a), witness.point_a)
    on_b = transform_points(inverse(T_world_b), witness.point_b)
    return np.where(wanted, on_a, np.nan), np.where(wanted, on_b, np.nan)
