"""Phases of an attempt at a grasp: contacts slide, settle, and close."""

from __future__ import annotations

from dataclasses import dataclass, replace

from grasp_refine.refinement.terms.weights import Weights
from grasp_refine.scene.contact_selection import ContactSelection


@dataclass(frozen=True)
class Phase:
    """Phase of an attempt, with its own contact links and weights."""

    name: str
    """Name for people, such as "moving the contacts"."""
    iterations: int
    """Largest number of iterations."""
    farther: tuple[float, float] = (0.0, 0.0)
    """Distances in metres added to the reach of contact links, and of other links, when contacts are selected."""
    soft: float = 1.0
    """Factor of the penetration weights: while contacts slide, links may penetrate a little."""
    balance: bool = True
    """Whether contact forces should balance."""
    stay: float = 0.0
    """Weight in m^2 of the movement from the input grasp, beside that of the settings."""
    patience: int = 8
    """Largest number of iterations without progress."""

    def touching(self, touching: ContactSelection) -> ContactSelection:
        """Return the contact selection of this phase, given that of the last phase."""
        tips, others = self.farther
        reach, distance = touching.reach + tips, touching.other_link_distance + others
        return replace(touching, reach=max(reach, 0.0), other_link_distance=max(distance, 0.0))

    def weights(self, weights: Weights) -> Weights:
        """Return the weights of this phase, given the weights of the last phase."""
        return replace(
            weights,
            penetration=self.soft * weights.penetration,
            self_penetration=self.soft * weights.self_penetration,
            wrench=weights.wrench if self.balance else 0.0,
            stay_near=weights.stay_near + self.stay,
        )


SLIDE = Phase("moving the contacts", 25, farther=(0.01, 0.005), soft=0.01)
SETTLE = Phase("settling the contacts", 15)
CLOSE = Phase("closing the gaps", 40, balance=False, patience=12)
KEEP = replace(CLOSE, farther=(-0.005, -0.001))
"""Gaps of an input grasp that is good enough close: links that are farther away are no part of it."""
PHASES = (SLIDE, SETTLE, CLOSE)
"""Contacts slide to where forces balance; they settle without penetration; last, by geometry alone, gaps close (see
`gap_closing`)."""

STAYS = (1e-5, 1e-6, 0.0)
"""Weights in m^2 that hold grasps back to the input grasp while forces are balanced, one attempt after the other."""
