"""The witness layer with patch witness points: values are those of the patch, derivatives are taken at its points."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from grasp_refine.collision.query import Pairs, Witness, query
from grasp_refine.witness.autograd import Derivative, WitnessLayer, _array, _WitnessFunction
from grasp_refine.witness.patch import Patch

from .aligned import moved_on_patch


class PatchLayer(WitnessLayer):
    """Witness points nearest to their targets, of all that are within epsilon of being the closest.

    How the patch itself moves has no derivative: points slip as `method` says of single witness points.
    """

    def __init__(self, pairs: Pairs, method: Derivative, patch: Patch) -> None:
        """Prepare the pairs; `method` is used in backward passes only."""
        super().__init__(pairs, method)
        self.patch = patch

    def __call__(
        self,
        T_world_a: Tensor,
        T_world_b: Tensor,
        target_a: Tensor | None = None,
        target_b: Tensor | None = None,
        *,
        cutoff: np.ndarray | float = np.inf,
        key: int = 0,
        previous: Witness | None = None,
    ) -> Witness:
        """What the witness layer says, for targets that are all given."""
        T_a, T_b = _array(T_world_a), _array(T_world_b)
        goals = _array(target_a), _array(target_b)
        found = query(self.pairs, T_a, T_b, cutoff=cutoff, previous=previous)
        found = moved_on_patch(self.patch, self.pairs, T_a, T_b, found, *goals)
        points = _WitnessFunction.apply(T_world_a, T_world_b, self, found, *goals, key)
        return Witness(*points, found.status, found.winner, found.asked)
