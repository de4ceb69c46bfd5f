"""Shards on a Dask cluster: each worker does one at a time, and the shards of lost workers are tried again."""

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
    """Work on shards; yield the result of each, in the order in which they end.

    Workers may join and leave meanwhile; one that joins late and is not fit gets no shard. Each has one shard at a
    time, and keeps to a group as in `run_local`. When the iterator is closed or interrupted, workers end their current
    shard, and no other is begun.

    Args:
        shards: The shards. Their paths must be valid on all machines.
        work: Work function, called on a worker with a shard; can be pickled, and imported there.
        address: Address of the scheduler, such as tcp://host:8786, or the file that it writes with --scheduler-file.
        tries: Maximum attempts at a shard whose worker is lost or hangs; one whose work raises is tried once.
        patience_s: Time without a heartbeat, seconds, after which a worker counts as hanging and is restarted; None:
            no limit.
        heartbeat: Called with the number of a shard and the entries of its `Sign`.

    Raises:
        GraspRefineError: Dask is not installed, the scheduler does not answer or is lost, there are no workers, or one
            of those that are there at the beginning is not fit: other versions, or no access to the results' folder.
    """
    shards = list(shards)
    if not shards:
        return
    try:
        from grasp_refine_apps.batch.cluster_client import connect
        from grasp_refine_apps.batch.cluster_workers import ClusterWorkers
    except ModuleNotFoundError as error:
        raise GraspRefineError(
            f"a cluster needs Dask distributed ({error.name} is missing): pip install 'grasp-refine[cluster]'"
        ) from error
    with connect(address) as client:
        workers = ClusterWorkers(client, address, work, shards[0].path.parent, patience_s)
        yield from dispatch(Schedule(shards), workers, tries, heartbeat)
