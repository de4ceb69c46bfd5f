"""Which shard a free worker gets: one whose hand and object it has loaded, as long as there are any."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable

from grasp_refine_apps.batch.shard import Shard


class Schedule:
    """The shards that nobody works on yet, by group, and which of them goes to whom.

    The first shard of a group is worked on alone, because it may decompose the object for all others; they wait for
    it as long as there is anything else to do.
    """

    def __init__(self, shards: Iterable[Shard]) -> None:
        """All shards of the batch; groups are opened in the order in which they occur."""
        self._waiting: defaultdict[str, deque[Shard]] = defaultdict(deque)
        for shard in shards:
            self._waiting[shard.group].append(shard)
        self._untouched = deque(self._waiting)
        self._touched: set[str] = set()
        """Groups with shards left of which some shard was taken: about as many as there are workers."""
        self._first: dict[str, int] = {}
        """Group -> number of its first shard, while that is worked on."""
        self._left = sum(map(len, self._waiting.values()))

    def __len__(self) -> int:
        """How many shards are waiting."""
        return self._left

    def take(self, loaded: str | None) -> Shard | None:
        """The next shard for a worker that has the group `loaded` at hand; None: nothing is left."""
        if loaded in self._touched and loaded not in self._first:
            return self._pop(loaded)
        if self._untouched:
            group = self._untouched.popleft()
            self._touched.add(group)
            shard = self._pop(group)
            self._first[group] = shard.number
            return shard
        if not self._touched:
            return None
        # Most shards left; one whose first shard is not done only if there is no other.
        return self._pop(max(sorted(self._touched), key=lambda each: (each not in self._first, self._count(each))))

    def ended(self, shard: Shard) -> None:
        """A shard is done with, well or not: the others of its group need not wait for it."""
        self._first.pop(shard.group, None)

    def again(self, shard: Shard) -> None:
        """A shard is to be tried once more, after the others of its group."""
        opened = self._first.get(shard.group) == shard.number
        if opened:
            del self._first[shard.group]
        self._waiting[shard.group].append(shard)
        self._left += 1
        if opened:
            self._touched.discard(shard.group)
            self._untouched.append(shard.group)
        else:
            self._touched.add(shard.group)

    def _count(self, group: str) -> int:
        return len(self._waiting[group])

    def _pop(self, group: str) -> Shard:
        shard = self._waiting[group].popleft()
        self._left -= 1
        if not self._waiting[group]:
            del self._waiting[group]
            self._touched.discard(group)
        return shard
