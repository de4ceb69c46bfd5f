"""A cluster that the tests of this folder share."""

from collections.abc import Iterator

import pytest

from dask_cluster import DaskCluster


@pytest.fixture(scope="package")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    """Two workers, each restarted when it dies."""
    started = DaskCluster(tmp_path_factory.mktemp("cluster"))
    try:
        started.add_workers("--nworkers", "2", "--nthreads", "1")
        yield started
    finally:
        started.end()


@pytest.fixture
def address(cluster: DaskCluster) -> str:
    """Address of a cluster whose two workers are there."""
    cluster.wait_for_workers(2)
    return cluster.address
