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
    """Work on shards; yield the result of each, in the order in which they end.

    Each worker is a spawned process with one thread for linear algebra. When the iterator is closed or interrupted,
    all workers are ended; when this process dies, so do they. One thread must advance the iterator to its end,
    because the kernel ends workers with the thread that started them.

    Args:
        shards: The shards; a worker that has done one of a group gets the others of it.
        work: Work function, called in a worker with a shard; can be pickled.
        workers: Number of processes; there are never more than shards.
        patience_s: Time without a heartbeat, seconds, after which a worker counts as hanging and is killed. Only time
            in which this process listens counts. The start of a worker counts, too.
        tries: Maximum attempts at a shard whose worker crashes or hangs; one whose work raises is tried once.
        heartbeat: Called with the number of a shard and the entries of its `Sign`.

    Raises:
        GraspRefineError: Workers cannot be started.
    """
    pool = WorkerPool(work, workers, patience_s)
    try:
        yield from dispatch(Schedule(shards), pool, tries, heartbeat)
    finally:
        pool.end()
