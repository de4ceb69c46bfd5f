"""Dispatch of a batch to any kind of workers: shards go out, results come back, lost shards go out again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Protocol, runtime_checkable

from grasp_refine_apps.batch.schedule import Schedule
from grasp_refine_apps.batch.shard import Done, Failed, Shard, Sign

Event = tuple[Shard, Sign | Done | Failed]
"""A shard with its heartbeat, or with its result."""


@runtime_checkable
class Workers(Protocol):
    """Workers for shards."""

    @property
    def busy(self) -> int:
        """Number of workers that have a shard."""
        ...

    def share_out(self, schedule: Schedule) -> None:
        """Give shards to idle workers, as long as there are any."""
        ...

    def listen(self) -> list[Event]:
        """Return the events since the last call, after a short wait if there are none."""
        ...


def dispatch(
    schedule: Schedule, workers: Workers, tries: int, heartbeat: Callable[[int, str, float, int], None]
) -> Iterator[Done | Failed]:
    """Dispatch shards to workers; yield the result of each, in the order in which they end.

    Args:
        schedule: The shards.
        workers: The workers.
        tries: Maximum attempts at a shard whose worker crashes or hangs; one whose work raises is tried once.
        heartbeat: Called with the number of a shard and the entries of its `Sign`.
    """
    lost: Counter[int] = Counter()
    ended: list[Done | Failed] = []
    while True:
        workers.share_out(schedule)
        # Only now, so that workers have shards while the caller handles the results.
        yield from ended
        if not workers.busy and not len(schedule):
            return
        ended = []
        for shard, event in workers.listen():
            if isinstance(event, tuple):
                heartbeat(shard.number, *event)
                continue
            if isinstance(event, Failed):
                lost[shard.number] += 1
                if event.reason != "error" and lost[shard.number] < tries:
                    schedule.requeue(shard)
                    continue
                event = replace(event, tries=lost[shard.number])
            lost.pop(shard.number, None)
            schedule.finish(shard)
            ended.append(event)
