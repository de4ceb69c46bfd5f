"""Bundle of shards that a worker refines together: grasps of one hand on several objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from grasp_refine_apps.batch.shard import Shard

MAX_GRASPS = 256
"""Largest number of grasps of a bundle of several shards: more at once are hardly faster."""

ROUNDS = 4
"""Least number of bundles for each worker, so that all are busy to the end."""


@dataclass(frozen=True)
class Bundle:
    """Shards of one hand, the unit of dispatch; their results do not depend on each other."""

    shards: tuple[Shard, ...]
    """The shards, one at least."""

    @property
    def number(self) -> int:
        """Number of the first shard."""
        return self.shards[0].number

    @property
    def group(self) -> str:
        """Group of the first shard."""
        return self.shards[0].group

    @property
    def size(self) -> int:
        """Number of grasps."""
        return sum(shard.size for shard in self.shards)


def bundles_of(shards: Sequence[Shard], workers: int) -> list[Bundle]:
    """Return shards in bundles, in their order: small shards of one hand together, where there are enough of them."""
    most = min(MAX_GRASPS, sum(shard.size for shard in shards) // (ROUNDS * max(workers, 1)))
    found: list[list[Shard]] = []
    for shard in shards:
        last = found[-1] if found else []
        if last and last[0].task.hand == shard.task.hand and sum(one.size for one in last) + shard.size <= most:
            last.append(shard)
        else:
            found.append([shard])
    return [Bundle(tuple(each)) for each in found]
