"""Shards on a Dask cluster: its workers do one at a time each, and those of lost workers are tried again."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from grasp_refine.errors import GraspRefineError

from .attempt import message_of, traceback_of
from .schedule import Schedule
from .shard import Done, Failed, Reason, Shard, Work

if TYPE_CHECKING:
    from distributed import Client, Future

ANSWER_S = 8.0
"""How long a scheduler may take to answer."""

LOOK_S = 1.0
"""Who has come and who has gone is looked at this often."""

ALONE_S = 60.0
"""Without any worker for so long, a batch ends."""

FETCH_S = 20.0
"""How long what came of a shard may take to arrive."""

PROBES = 3
"""How often a worker is asked for a file just written, a second apart: network file systems take a moment."""


def run_on_cluster(
    shards: Iterable[Shard],
    work: Work,
    *,
    address: str,
    tries: int = 2,
    patience_s: float | None = None,
    beat: Callable[[int, str, float], None],
) -> Iterator[Done | Failed]:
    """What comes of each shard, in the order in which they end.

    Workers may come and go meanwhile; one that comes and is not fit gets nothing to do. A worker has one shard at a
    time, and keeps to a group as in `run_local`. When the iterator is closed or interrupted, workers end the shard
    that they have, and no other is begun.

    Args:
        shards: What is to be done. Their paths must mean the same on all machines.
        work: Called on a worker with a shard; can be pickled, and imported there.
        address: Of the scheduler, such as tcp://host:8786, or the JSON file that it writes with --scheduler-file.
        tries: How often a shard is tried whose worker is lost or hangs; one whose work raises is tried once.
        patience_s: A worker without a sign of life for so long (s) hangs, and is restarted; None: it may.
        beat: Gets the number of a shard, what its worker is doing and the share that is done.

    Raises:
        GraspRefineError: Dask is not installed, the scheduler does not answer or is lost, there are no workers, or
            those that there are at the beginning have other versions or cannot get at the folder of the results.
    """
    schedule = Schedule(shards := list(shards))
    if not shards:
        return
    lost: Counter[int] = Counter()
    ended: list[Done | Failed] = []
    with _client(address) as client:
        cluster = _Cluster(client, address, work, shards[0].path.parent)
        while True:
            cluster.share_out(schedule)
            # Only now, so that workers have something to do while the caller looks at it.
            yield from ended
            if not cluster.busy and not len(schedule):
                return
            ended = []
            for shard, said in cluster.listen(patience_s):
                if isinstance(said, tuple):
                    beat(shard.number, *said)
                    continue
                if isinstance(said, Failed) and said.reason != "error":
                    lost[shard.number] += 1
                    if lost[shard.number] < tries:
                        schedule.again(shard)
                        continue
                    said = replace(said, tries=tries)
                elif isinstance(said, Failed):
                    said = replace(said, tries=lost[shard.number] + 1)
                lost.pop(shard.number, None)
                schedule.ended(shard)
                ended.append(said)


@dataclass
class _Run:
    """A shard on a worker."""

    shard: Shard
    future: Future
    heard: float
    """When there was last a sign of life."""
    doing: str = ""
    """What it was."""


class _Cluster:
    """The workers of a cluster, and what they are working on."""

    def __init__(self, client: Client, address: str, work: Work, folder: Path) -> None:
        """Nothing is begun yet.

        Args:
            client: Connected.
            address: Of the scheduler, for messages.
            work: What workers do with a shard.
            folder: Where results go.

        Raises:
            GraspRefineError: There is no worker, or one that is not fit.
        """
        self._client, self._address, self._work, self._folder = client, address, work, folder
        self._running: dict[str, _Run] = {}
        """Address of a worker -> its shard."""
        self._group: dict[str, str] = {}
        """Address of a worker -> the group of its last shard."""
        self._faults: dict[str, str] = {}
        """Address of each known worker -> why it is not fit; empty where it is."""
        self._inbox: SimpleQueue[Future | tuple[int, str, float]] = SimpleQueue()
        self._topic = f"grasp-refine-{uuid4().hex}"
        client.subscribe_topic(self._topic, lambda event: self._inbox.put(tuple(event[1])))
        self._looked = self._accompanied = time.monotonic()
        self._meet()
        faults = [fault for fault in self._faults.values() if fault]
        if faults:
            raise GraspRefineError(faults[0])
        if not self._faults:
            raise GraspRefineError(
                f"{address}: the cluster has no workers; start some with `dask worker {address} --nworkers 2 --nthreads 1`"
            )

    @property
    def busy(self) -> int:
        """How many workers have a shard."""
        return len(self._running)

    def share_out(self, schedule: Schedule) -> None:
        """Give every fit worker that has nothing to do a shard, as long as there are any."""
        from .cluster_worker import attempt_there

        for worker, fault in self._faults.items():
            if fault or worker in self._running or (shard := schedule.take(self._group.get(worker))) is None:
                continue
            key = f"{shard.name}-{uuid4().hex}"
            # On this worker and no other: a shard whose worker is lost comes back to us, who count how often.
            future = self._client.submit(
                attempt_there, self._work, shard, self._topic, key=key, workers=[worker], pure=False
            )
            future.add_done_callback(self._inbox.put)
            self._running[worker] = _Run(shard, future, time.monotonic())
            self._group[worker] = shard.group

    def listen(self, patience_s: float | None) -> list[tuple[Shard, tuple[str, float] | Done | Failed]]:
        """What was heard about shards, after a short wait if need be; lost workers are forgotten."""
        news: list[tuple[Shard, tuple[str, float] | Done | Failed]] = []
        try:
            message = self._inbox.get(timeout=LOOK_S)
            while True:
                news += self._understood(message)
                message = self._inbox.get_nowait()
        except Empty:
            pass
        if time.monotonic() - self._looked >= LOOK_S:
            self._meet()
            for worker in [worker for worker in self._running if worker not in self._faults]:
                news.append(self._lost(worker, "crashed", f"worker {worker} was lost"))
            for worker, run in list(self._running.items()):
                if patience_s is not None and time.monotonic() - run.heard > patience_s + LOOK_S:
                    news.append(self._lost(worker, "hung", f"worker {worker} gave no sign of life for {patience_s:g} s"))
                    self._restart(worker)
        return news
