"""Methods applied to grasps before they are tested, as values."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from grasp_refine.refinement.config import Config
from grasp_refine.refinement.losses import Weights

MethodName = Literal["as-came", "own-stages", "geometry-only", "forces"]
"""Names of the methods in rows."""


@dataclass(frozen=True)
class Method:
    """A method applied to grasps; all but `AS_CAME` end with a pregrasp and a squeeze of our own."""

    name: MethodName
    """Name in rows."""
    starts: int | None = None
    """Number of starts of a grasp that may not hold; None: it is not moved."""

    @property
    def label(self) -> str:
        """Label for people."""
        if self.name != "forces":
            return {"as-came": "input grasps", "own-stages": "own stages", "geometry-only": "geometry only"}[self.name]
        return "1 start" if self.starts == 1 else f"{self.starts} starts"

    def config(self, seed: int, width: int) -> Config | None:
        """Settings of the refinement; None where there is none."""
        if self.starts is None:
            return None
        weights = Weights() if self.name == "forces" else replace(Weights(), wrench=0.0)
        return Config(weights=weights, starts=self.starts, seed=seed, width=width)


AS_CAME = Method("as-came")
"""No change: the grasps with the pregrasps and squeezes of their file, or with ours where it has none."""

OWN_STAGES = Method("own-stages")
"""Only pregrasps and squeezes are ours."""

GEOMETRY_ONLY = Method("geometry-only", 1)
"""Contacts are closed and penetration is removed; forces are ignored."""


def methods(starts: tuple[int, ...], *, stages: bool) -> tuple[Method, ...]:
    """Return all methods to compare: the references, and refinement from each of the numbers of starts.

    Args:
        starts: Numbers of starts.
        stages: Whether the input grasps have pregrasps or squeezes, to be compared with ours.
    """
    own = (OWN_STAGES,) if stages else ()
    return (AS_CAME, *own, GEOMETRY_ONLY, *(Method("forces", count) for count in dict.fromkeys(starts)))
