"""The course of a batch, whoever works on it: shards go out, what came of them comes back, lost ones go out again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Protocol, runtime_checkable

from grasp_refine_apps.batch.schedule import Schedule
from grasp_refine_apps.batch.shard import Done, Failed, Shard, Sign

Event = tuple[Shard, Sign | Done | Failed]
"""What was heard about a shard: a sign of life, or what came of it."""


@runtime_checkable
class Workers(Protocol):
    """Those who work on shards."""

    @property
    def busy(self) -> int:
        """How many have a shard."""
        ...

    def share_out(self, schedule: Schedule) -> None:
        """Give shards to those who have none, as long as there are any."""
        ...

    def listen(self) -> list[Event]:
        """What was heard since the last time, after a short wait if need be."""
        ...


def dispatch(
    schedule: Schedule, workers: Workers, tries: int, heartbeat: Callable[[int, str, float, int], None]
) -> Iterator[Done | Failed]:
    """What comes of each shard, in the order in which they end.

    Args:
        schedule: The shards.
        workers: Those who work on them.
        tries: How often a shard is tried whose worker crashes or hangs; one whose work raises is tried once.
        heartbeat: Gets the number of a shard, and what a `Sign` of it holds.
    """
    lost: Counter[int] = Counter()
    ended: list[Done | Failed] = []
    while True:
        workers.share_out(schedule)
        # Only now, so that workers have something to do while the caller looks at it.
        yield from ended
        if not workers.busy and not len(schedule):
            return
        ended = []
        for shard, said in workers.listen():
            if isinstance(said, tuple):
                heartbeat(shard.number, *said)
                continue
            if isinstance(said, Failed):
                lost[shard.number] += 1
                if said.reason != "error" and lost[shard.number] < tries:
                    schedule.again(shard)
                    continue
                said = replace(said, tries=lost[shard.number])
            lost.pop(shard.number, None)
            schedule.ended(shard)
            ended.append(said)
