"""Shards in worker processes of this machine: one that crashes or hangs is replaced, and the others go on."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable

from grasp_refine_apps.batch.dispatch import dispatch
from grasp_refine_apps.batch.schedule import Schedule
from grasp_refine_apps.batch.shard import Done, Failed, Shard, Work
from grasp_refine_apps.batch.worker_pool import WorkerPool


def run_local(
    shards: Iterable[Shard],
    work: Work,
    *,
    workers: int,
    patience_s: float,
    tries: int = 2,
    heartbeat: Callable[[int, str, float, int], None],
) -> Generator[Done | Failed, None, None]:
    """What comes of each shard, in the order in which they end.

    Each worker is a spawned process with one thread for linear algebra. When the iterator is closed or interrupted,
    all workers are ended; when this process dies, so do they. One thread has to advance the iterator to its end,
    because the kernel ends workers with the thread that started them.

    Args:
        shards: What is to be done; a worker that has done one of a group gets the others of it.
        work: Called in a worker with a shard; can be pickled.
        workers: Number of processes; there are never more than shards.
        patience_s: A worker without a sign of life for so long (s) hangs, and is killed. Only time in which this
            process was there to hear one counts. Starting takes patience, too.
        tries: How often a shard is tried whose worker crashes or hangs; one whose work raises is tried once.
        heartbeat: Gets the number of a shard, and what a `Sign` of it holds.

    Raises:
        GraspRefineError: Workers cannot be started.
    """
    pool = WorkerPool(work, workers, patience_s)
    try:
        yield from dispatch(Schedule(shards), pool, tries, heartbeat)
    finally:
        pool.end()
