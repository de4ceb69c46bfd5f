"""Fidelity of transferred grasps: whether each finger touches where the finger whose place it takes did."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from grasp_refine.collision.query import Witness
from grasp_refine.core.array_types import Bool, Float, Shaped
from grasp_refine.core.se3 import matvec
from grasp_refine.hands.hand import Hand
from grasp_refine.measures.geometry import worst_over_links
from grasp_refine.scene.contact_selection import CONTACT_DISTANCE_M, link_groups
from grasp_refine.scene.original import Original

SAME_M = 0.015
"""Distance in metres up to which a contact is where that of the original is: about the breadth of a fingertip."""

OTHER_M = 0.04
"""Distance in metres of the thumb or the finger that presses against it from which on it is another grasp."""

OTHER_RAD = np.radians(60.0)
"""Angle between approach directions from which on it is another grasp."""


class Likeness(StrEnum):
    """Likeness of a transferred grasp to its original."""

    SAME = "same grasp"
    """All fingers of the original are kept, and the thumb and the finger that presses against it by up to `SAME_M`;
    where its thumb does not touch, all fingers."""
    MOVED = "contacts moved"
    """All are kept, but one of these two moved farther."""
    DROPPED = "fingers dropped"
    """Some fingers of the original have no place, or the finger in their place does not touch."""
    OTHER = "another grasp"
    """Less than half of the fingers in a place touch; the thumb, or the finger that presses against it, does not, or is
    over `OTHER_M` away; or the hand comes from another side, by over `OTHER_RAD`."""


@dataclass(frozen=True, eq=False)
class Fidelity:
    """Fidelity of N grasps of a hand with k fingers."""

    distance: Float[np.ndarray, "N k"]
    """Distance (N, k) of the contact of each finger from the contact of the original in its place, metres; NaN where
    either does not touch."""
    original: Original
    """Contacts of the originals."""
    turn: Float[np.ndarray, " N"]
    """Angle (N,) between the approach directions, radians."""

    @staticmethod
    def of(
        hand: Hand,
        links: tuple[str, ...],
        original: Original,
        witness: Witness,
        T_world_palm: Float[np.ndarray, "N 4 4"],
    ) -> Fidelity:
        """Measure grasps with witness points of the L `links` and poses (N, 4, 4) of the palm.

        A finger touches where one of its links is within `CONTACT_DISTANCE_M` of the object; of several, the contact
        nearest to that of the original counts.
        """
        groups = np.array(link_groups(hand, links))
        touches = witness.valid & (witness.distance <= CONTACT_DISTANCE_M)
        distance = np.full(original.finger.shape, np.nan)
        for k, finger in enumerate(hand.fingers):
            away = np.linalg.norm(witness.point_b - original.point[:, k, None], axis=-1)
            away = np.where(touches & (groups == finger), away, np.nan)
            distance[:, k] = np.fmin.reduce(away, axis=1)
        with np.errstate(invalid="ignore"):
            cosine = (matvec(T_world_palm[:, :3, :3], original.own_approach) * original.approach).sum(axis=1)
        return Fidelity(distance, original, np.arccos(np.clip(cosine, -1.0, 1.0)))

    @property
    def taken(self) -> Bool[np.ndarray, "N k"]:
        """Mask (N, k) of the fingers that take the place of another one."""
        return self.original.finger != ""

    @property
    def original_shift(self) -> Float[np.ndarray, " N"]:
        """Median (N,) of the distances, metres; NaN without any."""
        known = ~np.isnan(self.distance)
        ordered = np.sort(self.distance, axis=1)  # NaN last
        count, rows = known.sum(axis=1), np.arange(len(known))
        both = ordered[rows, np.maximum(count - 1, 0) // 2], ordered[rows, np.minimum(count // 2, known.shape[1] - 1)]
        return np.where(count > 0, np.where(count % 2 == 1, both[0], 0.5 * (both[0] + both[1])), np.nan)

    @property
    def original_shift_most(self) -> Float[np.ndarray, " N"]:
        """Largest (N,) of the distances, metres; NaN without any."""
        return worst_over_links(self.distance)

    @property
    def original_pinch_shift(self) -> Float[np.ndarray, " N"]:
        """Larger distance (N,) of the thumb and the finger that presses against it, metres; NaN without both."""
        return worst_over_links(np.where(self.original.opposed, self.distance, np.nan))

    @property
    def original_kept(self) -> Float[np.ndarray, " N"]:
        """Share (N,) of the fingers that touch in the original whose place a finger takes that touches."""
        lost = np.array([len(names.split(", ")) if names else 0 for names in self.original.dropped.tolist()], dtype=int)
        count = self.taken.sum(axis=1) + lost
        return np.where(count > 0, (~np.isnan(self.distance)).sum(axis=1) / np.maximum(count, 1), np.nan)

    @property
    def original_turn(self) -> Float[np.ndarray, " N"]:
        """Angle (N,) between the approach directions, radians."""
        return self.turn

    @property
    def likeness(self) -> Shaped[np.ndarray, " N"]:
        """Return the `Likeness` (N,) as text."""
        kept, opposed = self.original_kept, self.original.opposed
        pinch = np.where(opposed.any(axis=1), self.original_pinch_shift, self.original_shift_most)
        lost = (opposed & np.isnan(self.distance)).any(axis=1)
        touching = (~np.isnan(self.distance)).sum(axis=1)
        other = (
            (touching == 0)
            | (2 * touching < self.taken.sum(axis=1))
            | lost
            | (pinch > OTHER_M)
            | ~(self.turn <= OTHER_RAD)
        )
        cases = [other, kept < 1.0, pinch > SAME_M]
        return np.select(
            cases, [each.value for each in (Likeness.OTHER, Likeness.DROPPED, Likeness.MOVED)], Likeness.SAME.value
        )

    def texts(self, fingers: Sequence[str]) -> Shaped[np.ndarray, " N"]:
        """Return a text (N,) on each finger that touches in the original, such as "index by finger_1: moved 18 mm".

        `fingers` are the names of the hand's k fingers.
        """
        return np.array([self._text(row, fingers) for row in range(len(self.distance))], dtype=str)

    def _text(self, row: int, fingers: Sequence[str]) -> str:
        parts = []
        for k, finger in enumerate(fingers):
            name, away = str(self.original.finger[row, k]), self.distance[row, k]
            if not name:
                continue
            how = "does not touch" if np.isnan(away) else "kept" if away <= SAME_M else f"moved {1e3 * away:.0f} mm"
            parts.append(f"{name if name == finger else f'{name} by {finger}'}: {how}")
        lost = str(self.original.dropped[row])
        return "; ".join([*parts, *(f"{name}: dropped" for name in lost.split(", ") if name)])
