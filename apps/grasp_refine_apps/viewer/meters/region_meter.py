"""Links of the shown grasp that touch an object where they should not, by its regions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from threading import Lock

import numpy as np

from grasp_refine.core.plurals import first_of
from grasp_refine.measures.formulas import COSTLY_M
from grasp_refine.objects.region import ContactRegions
from grasp_refine.scene.contact_patches import patch_misses
from grasp_refine_apps.viewer.model.contacts import Contacts

MAX_NAMED = 2
"""Number of links that a line of text names; it counts the others."""


@dataclass(frozen=True)
class Elsewhere:
    """A link that touches the object elsewhere than it should."""

    link: str
    """Name of the link."""
    reason: str
    """Distance from where it may touch, and the region, as of `ContactRegions.reason`."""
    miss: float
    """The distance in metres."""

    def __str__(self) -> str:
        return f"{self.link}, {self.reason}"


class RegionMeter:
    """Links that touch elsewhere; the last contacts' are kept."""

    def __init__(self) -> None:
        """Start without contacts."""
        self._lock = Lock()
        self._last: tuple[Contacts, ContactRegions, tuple[Elsewhere, ...]] | None = None

    def __call__(self, contacts: Contacts, regions: ContactRegions | None) -> tuple[Elsewhere, ...]:
        """Return the links that touch where they should not by more than costs nothing, the farthest first."""
        if regions is None:
            return ()
        with self._lock:
            if self._last is None or self._last[0] is not contacts or self._last[1] is not regions:
                self._last = contacts, regions, _elsewhere(contacts, regions)
            return self._last[2]


def elsewhere_text(found: Sequence[Elsewhere]) -> str:
    """Return text that names the links that are farthest from where they may touch; empty: there is none."""
    named = "; ".join(first_of([str(one) for one in found], MAX_NAMED))
    return f"touches elsewhere: {named}" if named else ""


def _elsewhere(contacts: Contacts, regions: ContactRegions) -> tuple[Elsewhere, ...]:
    prepared = contacts.prepared
    geometry = prepared.bodies, prepared.object.body, contacts.frames.T_world_link, contacts.witness
    misses = patch_misses(regions, *geometry)
    found = [
        Elsewhere(prepared.chain.links[k], regions.reason(misses.point[0, k]), float(misses.miss[0, k]))
        for k in np.flatnonzero(misses.miss[0] > COSTLY_M[0])
    ]
    return tuple(sorted(found, key=lambda one: -one.miss))
