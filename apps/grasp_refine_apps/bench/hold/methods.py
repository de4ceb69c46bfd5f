"""What is done to grasps before they are tested, as values."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from grasp_refine.refinement.config import Config
from grasp_refine.refinement.losses import Weights

MethodName = Literal["as-came", "own-stages", "geometry-only", "forces"]
"""Names of the methods in rows."""


@dataclass(frozen=True)
class Method:
    """What is done to grasps; all but `AS_CAME` end with a pregrasp and a squeeze of our own."""

    name: MethodName
    """What rows call it."""
    starts: int | None = None
    """From how many starts a grasp that may not hold is tried; None: it stays where it is."""

    @property
    def label(self) -> str:
        """What people call it."""
        if self.name != "forces":
            return {"as-came": "as they came", "own-stages": "own stages", "geometry-only": "geometry only"}[self.name]
        return "1 start" if self.starts == 1 else f"{self.starts} starts"

    def config(self, seed: int, width: int) -> Config | None:
        """The settings of the refinement; None where there is none."""
        if self.starts is None:
            return None
        weights = Weights() if self.name == "forces" else replace(Weights(), wrench=0.0)
        return Config(weights=weights, starts=self.starts, seed=seed, width=width)


AS_CAME = Method("as-came")
"""Nothing: the grasps with the pregrasps and squeezes of their file, or with ours where it has none."""

OWN_STAGES = Method("own-stages")
"""Only pregrasps and squeezes are ours."""

GEOMETRY_ONLY = Method("geometry-only", 1)
"""Contacts are closed and penetration is removed; forces do not count."""


def methods(starts: tuple[int, ...], *, stages: bool) -> tuple[Method, ...]:
    """All that is compared: the references, and refinement from each of the numbers of starts.

    Args:
        starts: Numbers of starts.
        stages: Whether the grasps come with pregrasps or squeezes, so that ours can be told from them.
    """
    own = (OWN_STAGES,) if stages else ()
    return (AS_CAME, *own, GEOMETRY_ONLY, *(Method("forces", count) for count in dict.fromkeys(starts)))
