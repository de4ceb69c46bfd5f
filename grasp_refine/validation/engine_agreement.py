"""Agreement of two engines on which grasps hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grasp_refine.core.array_types import Bool


@dataclass(frozen=True)
class EngineAgreement:
    """Numbers of grasps that held in a first and in a second engine."""

    both: int
    """Number of grasps that held in both."""
    first_only: int
    """Number of grasps that held in the first alone."""
    second_only: int
    """Number of grasps that held in the second alone."""
    neither: int
    """Number of grasps that held in none."""

    @staticmethod
    def of(first: Bool[np.ndarray, " N"], second: Bool[np.ndarray, " N"]) -> EngineAgreement:
        """Return the agreement on N grasps, given which held in each."""
        counts = (first & second, first & ~second, ~first & second, ~first & ~second)
        return EngineAgreement(*(int(count.sum()) for count in counts))

    @property
    def count(self) -> int:
        """Number of grasps."""
        return self.both + self.first_only + self.second_only + self.neither

    @property
    def share(self) -> float:
        """Share of grasps with the same verdict in both; NaN without grasps."""
        return (self.both + self.neither) / self.count if self.count else np.nan

    @property
    def kappa(self) -> float:
        """Agreement beyond chance: Cohen's (1960) kappa.

        It is (p - e) / (1 - e), with the share p of equal verdicts and the share e that two engines would have by
        chance that hold as many grasps each. NaN where e is 1: all grasps have one verdict, and chance agrees too.
        """
        if not self.count:
            return np.nan
        first, second = (self.both + self.first_only) / self.count, (self.both + self.second_only) / self.count
        chance = first * second + (1 - first) * (1 - second)
        return (self.share - chance) / (1 - chance) if chance < 1 else np.nan
