"""Shards on a Dask cluster: its workers do one at a time each, and those of lost workers are tried again."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.batch.dispatch import dispatch
from grasp_refine_apps.batch.schedule import Schedule
from grasp_refine_apps.batch.shard import Done, Failed, Shard, Work


def run_on_cluster(
    shards: Iterable[Shard],
    work: Work,
    *,
    address: str,
    tries: int = 2,
    patience_s: float | None = None,
    heartbeat: Callable[[int, str, float, int], None],
) -> Generator[Done | Failed, None, None]:
    """What comes of each shard, in the order in which they end.

    Workers may come and go meanwhile; one that comes late and is not fit gets nothing to do. Each has one shard at a
    time, and keeps to a group as in `run_local`. When the iterator is closed or interrupted, workers end the shard
    that they have, and no other is begun.

    Args:
        shards: What is to be done. Their paths must mean the same on all machines.
        work: Called on a worker with a shard; can be pickled, and imported there.
        address: Of the scheduler, such as tcp://host:8786, or the file that it writes with --scheduler-file.
        tries: How often a shard is tried whose worker is lost or hangs; one whose work raises is tried once.
        patience_s: A worker without a sign of life for so long (s) hangs, and is restarted; None: is waited for.
        heartbeat: Gets the number of a shard, and what a `Sign` of it holds.

    Raises:
        GraspRefineError: Dask is not installed, the scheduler does not answer or is lost, there are no workers, or one
            of those that are there at the beginning is not fit: other versions, or no access to the results' folder.
    """
    shards = list(shards)
    if not shards:
        return
    try:
        from grasp_refine_apps.batch.cluster_client import connected
        from grasp_refine_apps.batch.cluster_workers import ClusterWorkers
    except ModuleNotFoundError as error:
        raise GraspRefineError(
            f"a cluster needs Dask distributed ({error.name} is missing): pip install 'grasp-refine[cluster]'"
        ) from error
    with connected(address) as client:
        workers = ClusterWorkers(client, address, work, shards[0].path.parent, patience_s)
        yield from dispatch(Schedule(shards), workers, tries, heartbeat)
