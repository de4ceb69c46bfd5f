"""Results of trajectories that were followed in simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from grasp_refine.core.array_types import Bool, Float
from grasp_refine.core.plurals import first_of
from grasp_refine.core.short_repr import brief
from grasp_refine.validation.trials import PUSHED_M

NUMBERS = ("lifted_m", "displacement_m", "angle_rad", "tracking_m", "tracking_rad")
"""Fields of `Executions` with one number for each grasp."""

MAX_TOLD_HITS = 4
"""Number of hits of a grasp that a line of text names; it counts the others."""


@dataclass(frozen=True, eq=False)
class Executions:
    """N trajectories as followed in simulation; NaN where there was none to follow."""

    followed: Bool[np.ndarray, " N"]
    """True (N,) where there was a trajectory, which was simulated."""
    held: Bool[np.ndarray, " N"]
    """True (N,) where the palm has lifted the object at the end, within the protocol's limits of where it should be."""
    lifted_m: Float[np.ndarray, " N"]
    """Height (N,) by which the object was lifted, metres."""
    displacement_m: Float[np.ndarray, " N"]
    """Distance (N,) of the object from where it should be at the end, metres."""
    angle_rad: Float[np.ndarray, " N"]
    """Rotation (N,) of the object since its start, radians."""
    tracking_m: Float[np.ndarray, " N"]
    """Largest distance (N,) of the palm from its set point, metres."""
    tracking_rad: Float[np.ndarray, " N"]
    """Largest rotation (N,) of the palm from its set point, radians."""
    pushed_m: Float[np.ndarray, "N V"]
    """Displacement (N, V) of the movable bodies around the object at the end, metres."""
    hits: np.ndarray
    """Tuples (N,) of texts: what touched that should not have, such as "approach: forearm_link and shelf", each once.

    Links of hand and arm and bodies of the scene; links and the object before the hand closes; the object and what it
    did not touch before the lift.
    """
    neighbours: tuple[str, ...]
    """Names of the V movable bodies."""

    __repr__ = brief

    def __len__(self) -> int:
        """Return the number of grasps."""
        return len(self.held)

    @property
    def clean(self) -> Bool[np.ndarray, " N"]:
        """True (N,) where a trajectory was followed and nothing was hit."""
        return self.followed & np.array([not hits for hits in self.hits], dtype=bool)

    def lines(self, most: int = 5, labels: Sequence[str] | None = None) -> list[str]:
        """Return lines for people: grasps held, and bodies hit or pushed, in `most` of them.

        Args:
            most: Largest number of grasps that are listed.
            labels: Numbers of the grasps (N,) as text; by default from 0 on.
        """
        ran = np.flatnonzero(self.followed)
        if not len(ran):
            return ["followed in simulation: none, as no trajectory is free"]
        lines = [
            f"followed in simulation: {int(self.held.sum())} of {len(ran)} held and lifted, nothing hit in "
            f"{int(self.clean.sum())}{self._tracking()}"
        ]
        others = [(row, text) for row in ran.tolist() if (text := self._incident(row))]
        return lines + first_of([f"grasp {labels[row] if labels else row}: {text}" for row, text in others], most)

    def _tracking(self) -> str:
        """Return text on the largest tracking error; empty where none is known."""
        if np.isnan(self.tracking_m).all():
            return ""
        away, turned = 1e3 * np.nanmax(self.tracking_m), np.degrees(np.nanmax(self.tracking_rad))
        return f"; the palm at most {away:.1f} mm and {turned:.1f} degrees from the trajectory"

    def _incident(self, row: int) -> str:
        """Return what went wrong with a grasp; empty: nothing."""
        lost = [] if self.held[row] else ["the simulation diverged"]
        if lost and np.isfinite(self.displacement_m[row]):
            away, turned = 1e3 * self.displacement_m[row], np.degrees(self.angle_rad[row])
            lost = [f"lost, {away:.0f} mm and {turned:.0f} degrees from where it should be"]
        pushed = [
            f"pushed {name} {1e3 * away:.0f} mm"
            for name, away in zip(self.neighbours, self.pushed_m[row].tolist(), strict=True)
            if away >= PUSHED_M
        ]
        return "; ".join([*lost, *pushed, *first_of(self.hits[row], MAX_TOLD_HITS)])

    def document(self, row: int) -> dict[str, Any] | None:
        """Return the entry of a grasp in a JSON file; None where there was no trajectory to follow."""
        if not self.followed[row]:
            return None
        pushed = dict(zip(self.neighbours, self.pushed_m[row].tolist(), strict=True))
        numbers = {name: getattr(self, name)[row].item() for name in NUMBERS}
        return {"held": bool(self.held[row]), **numbers, "pushed_m": pushed, "hits": list(self.hits[row])}

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of an .npz file; hits are texts, one after the other."""
        arrays = {name: getattr(self, name) for name in ("followed", "held", *NUMBERS, "pushed_m")}
        hits = np.array(["; ".join(hits) for hits in self.hits], dtype=np.str_)
        return {**arrays, "hits": hits, "neighbours": np.array(self.neighbours, dtype=np.str_)}
