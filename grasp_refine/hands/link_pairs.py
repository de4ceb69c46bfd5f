"""Pairs of links of a hand, for their distances at joint values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from grasp_refine.collision.query import Pairs, query
from grasp_refine.core.array_types import Float
from grasp_refine.core.errors import HandError
from grasp_refine.hands.chain import Chain
from grasp_refine.hands.files.tree import LinkPair
from grasp_refine.hands.hand import Hand
from grasp_refine.hands.kept import kept

_BLOCK, _BLOCK_POSES = 256, 2**20
"""Configurations, and configurations times pairs, that are queried at a time, which bounds the memory."""


@dataclass(frozen=True, eq=False)
class LinkPairs:
    """Pairs of solid links of a hand, for their distances."""

    chain: Chain
    """Kinematics of the links."""
    pairs: Pairs | None
    """The pairs; None: there are none."""
    first: list[int]
    """Index of the first link of each pair among the links of the chain."""
    second: list[int]
    """Index of the second link."""

    @staticmethod
    def of(hand: Hand, named: Sequence[LinkPair]) -> LinkPairs:
        """Prepare pairs of links.

        Raises:
            HandError: the hand has no such link, or it has no body.
        """
        names = sorted({name for pair in named for name in pair})
        chain = Chain(hand, names)
        for name in names:
            if hand.links_by_name[name].body is None:
                raise HandError(f"hand {hand.name}: link '{name}' has no collision geometry")
        first, second = ([names.index(pair[side]) for pair in named] for side in (0, 1))
        bodies = [hand.links_by_name[name].solid for name in names]
        pairs = Pairs(tuple(bodies[i] for i in first), tuple(bodies[j] for j in second)) if named else None
        return LinkPairs(chain, pairs, first, second)

    def distances(self, q: Float[np.ndarray, "batch n"], cutoff: float) -> Float[np.ndarray, "batch pairs"]:
        """Signed distances (batch, pairs) in metres; the cutoff where it is larger, NaN without a result."""
        distance = np.empty((len(q), len(self.first)))
        if self.pairs is None:
            return distance
        rows = max(min(_BLOCK, _BLOCK_POSES // len(self.pairs)), 1)
        for start in range(0, len(q), rows):
            block = q[start : start + rows]
            # Configurations that are not finite have no result.
            with np.errstate(invalid="ignore"):
                T = self.chain(np.broadcast_to(np.eye(4), (len(block), 4, 4)), block).T_world_link
            found = query(self.pairs, T[:, self.first], T[:, self.second], cutoff=cutoff)
            distance[start : start + rows] = found.distance
        return distance


@kept
def link_pairs(hand: Hand, named: tuple[LinkPair, ...]) -> LinkPairs:
    """Return `LinkPairs.of` the hand, prepared once."""
    return LinkPairs.of(hand, named)
