"""Order of the shards: an idle worker first gets those whose hand and object it has loaded."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable

from grasp_refine_apps.batch.shard import Shard


class Schedule:
    """Shards waiting for a worker, by group, and the choice of the next one.

    The first shard of a group runs alone, because it may decompose the object for all others; they wait for it as
    long as there are other shards.
    """

    def __init__(self, shards: Iterable[Shard]) -> None:
        """Queue all shards of the batch; groups are opened in the order in which they occur."""
        self._waiting: defaultdict[str, deque[Shard]] = defaultdict(deque)
        for shard in shards:
            self._waiting[shard.group].append(shard)
        self._untouched = deque(self._waiting)
        self._touched: set[str] = set()
        """Opened groups with shards left: about as many as there are workers."""
        self._first: dict[str, int] = {}
        """Group -> number of its first shard, while that one runs."""
        self._left = sum(map(len, self._waiting.values()))

    def __len__(self) -> int:
        """Return the number of waiting shards."""
        return self._left

    def take(self, loaded: str | None) -> Shard | None:
        """Take the next shard for a worker that has loaded the group `loaded`; None: none is left."""
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
        # The group with most shards left; one whose first shard still runs only if there is no other.
        return self._pop(max(sorted(self._touched), key=lambda each: (each not in self._first, self._count(each))))

    def finish(self, shard: Shard) -> None:
        """Mark a shard as complete or failed: the others of its group need not wait for it."""
        self._first.pop(shard.group, None)

    def requeue(self, shard: Shard) -> None:
        """Queue a shard for another attempt, after the others of its group."""
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
