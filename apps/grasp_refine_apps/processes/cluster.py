"""Workers of a Dask cluster: which there are, whether they are fit, and which are lost."""

from __future__ import annotations

import json
import logging
import pickle
import socket
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any
from uuid import uuid4

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.processes.dispatch import Lost
from grasp_refine_apps.processes.task import Failed, Sign, Task, Work, message_of

try:
    from distributed import Client, Future
    from distributed.comm.addressing import get_address_host_port
    from distributed.scheduler import KilledWorker

    from grasp_refine_apps.processes.cluster_worker import (
        WorkerEnvironment,
        attempt_on_worker,
        fault_of,
        inspect_environment,
    )
except ModuleNotFoundError as error:
    raise GraspRefineError(
        f"a cluster needs Dask distributed ({error.name} is missing): pip install 'grasp-refine[cluster]'"
    ) from error

ANSWER_LIMIT_S = 8.0
"""Time limit for an answer of the scheduler, seconds."""

POLL_INTERVAL_S = 1.0
"""Interval between two checks for new and lost workers, seconds."""

NO_WORKER_LIMIT_S = 60.0
"""Time without any fit worker after which a run ends, seconds."""

FETCH_LIMIT_S = 20.0
"""Time limit for the arrival of a result, and for the restart of a worker, seconds."""

MAX_PROBES = 4
"""Number of times, a second apart, that a worker looks for a new file: shared folders may show it late."""


@contextmanager
def connect(address: str) -> Iterator[Client]:
    """Connect to the scheduler at `address`, or to the one that wrote the file of that name; its log is not shown.

    Raises:
        GraspRefineError: No scheduler answers.
    """
    with _silenced_log():
        try:
            if address.endswith(".json"):
                address = str(json.loads(Path(address).read_text(encoding="utf-8"))["address"])
            # A client that finds no scheduler leaves threads behind, so the connection is tested first.
            socket.create_connection(get_address_host_port(address), ANSWER_LIMIT_S).close()
            client = Client(address, timeout=ANSWER_LIMIT_S, set_as_default=False)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise GraspRefineError(
                f"{address}: no Dask scheduler answers ({message_of(error)}); start one with `dask scheduler` and give "
                "its address, such as tcp://host:8786, or the file that it writes with --scheduler-file"
            ) from error
        with client:
            yield client


@contextmanager
def _silenced_log() -> Iterator[None]:
    """Silence the log of Dask meanwhile: users get messages of our own."""
    loggers = [logging.getLogger(name) for name in logging.root.manager.loggerDict if name.startswith("distributed")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


class ClusterPool:
    """Workers of a cluster, named by their addresses, for one run.

    They may join and leave meanwhile; one that joins late and is not fit gets no task. When the pool is closed, they
    end their current task, and no other is begun.
    """

    has_queues = True
    """Other clients may have given tasks to the same workers."""

    def __init__(self, client: Client, address: str, work: Work, folder: Path) -> None:
        """Check the workers; no task is begun yet.

        Args:
            client: Client of `connect`.
            address: Address of the scheduler, for messages.
            work: Work function; can be imported on the workers.
            folder: Folder of the results, which all machines must share.

        Raises:
            GraspRefineError: There is no worker, or one that is not fit: other versions, or no access to the folder.
        """
        self._client, self._address, self._folder, self._work = client, address, folder, pickle.dumps(work)
        self._attempts: dict[str, tuple[str, Future]] = {}
        """Key of each attempt that has not ended -> its worker and its future."""
        self._faults: dict[str, str] = {}
        """Worker -> reason why it is not fit; empty if it is."""
        self._inbox: SimpleQueue[tuple[str, Sign | None]] = SimpleQueue()
        """Keys of attempts, each with a heartbeat or, at its end, None."""
        self._topic = f"grasp-refine-{uuid4().hex}"
        client.subscribe_topic(self._topic, self._put_sign)
        self._last_worker_s = self._last_poll_s = time.monotonic()
        self._poll_workers()
        if not self._faults:
            raise GraspRefineError(
                f"{address}: the cluster has no workers; start some with "
                f"`dask worker {address} --nworkers 2 --nthreads 1`"
            )
        for fault in filter(None, self._faults.values()):
            raise GraspRefineError(fault)

    def workers(self, wanted: int) -> list[str]:
        """Return the addresses of the fit workers; others join by themselves."""
        return [worker for worker, fault in self._faults.items() if not fault]

    def submit(self, worker: str, task: Task) -> None:
        """Give a task to this worker alone: if it is lost, the task returns to `dispatch`, which counts attempts."""
        key = f"{self._topic}-{task.number}-{uuid4().hex}"
        future = self._client.submit(
            attempt_on_worker, self._work, task, self._topic, key, key=key, workers=[worker], pure=False
        )
        self._attempts[key] = worker, future
        future.add_done_callback(lambda future: self._inbox.put((key, None)))

    def listen(self) -> list[tuple[str, Any]]:
        """Return the messages of workers, after a short wait if there are none.

        Raises:
            GraspRefineError: The scheduler, or all its workers, are lost.
        """
        messages: list[tuple[str, Any]] = []
        try:
            key, sign = self._inbox.get(timeout=POLL_INTERVAL_S)
            while True:
                # Others are from an attempt that was given up.
                if key in self._attempts:
                    worker, future = self._attempts[key]
                    messages.append((worker, self._outcome(worker, future) if sign is None else sign))
                    if sign is None:
                        del self._attempts[key]
                key, sign = self._inbox.get_nowait()
        except Empty:
            pass
        if time.monotonic() - self._last_poll_s >= POLL_INTERVAL_S:
            self._poll_workers()
            for worker in {worker for worker, _ in self._attempts.values()} - set(self._faults):
                self._give_up(worker)
                messages.append((worker, Lost("was lost")))
        return messages

    def restart(self, worker: str) -> str:
        """Restart a worker that hangs; one that cannot be restarted gets no more tasks. Its log is not here."""
        self._give_up(worker)
        try:
            self._client.restart_workers([worker], timeout=FETCH_LIMIT_S, raise_for_error=False)
            # From now on a worker of this address is a new one.
            self._faults.pop(worker, None)
        except ValueError:
            self._faults[worker] = f"worker {worker} hangs, and has no nanny to restart it"
        except (OSError, TimeoutError, CancelledError) as failure:
            raise self._scheduler_lost(failure) from failure
        return ""

    def _give_up(self, worker: str) -> None:
        """Forget the attempt of a worker."""
        for key, (busy, future) in list(self._attempts.items()):
            if busy == worker:
                future.release()
                del self._attempts[key]

    def _put_sign(self, event: tuple[float, tuple[str, str, float, int]]) -> None:
        """Receive a worker's event: its clock, and the key of the attempt with the entries of a `Sign`."""
        _, (key, what, share, finished) = event
        self._inbox.put((key, Sign(what, share, finished)))

    def _outcome(self, worker: str, future: Future) -> Any:
        """Result or failure of an attempt that ended; Lost if it was lost."""
        try:
            if future.status != "error":
                return future.result(timeout=FETCH_LIMIT_S)
            error = future.exception(timeout=FETCH_LIMIT_S)
        except TimeoutError:
            return Lost("was lost with its result")
        except (OSError, CancelledError) as failure:
            raise self._scheduler_lost(failure) from failure
        return Lost(f"was lost ({message_of(error)})") if isinstance(error, KilledWorker) else Failed.of(error)

    def _poll_workers(self) -> None:
        """Update the list of workers, and check whether new ones are fit."""
        try:
            threads: Mapping[str, int] = self._client.nthreads()
            new = [worker for worker in threads if worker not in self._faults]
            self._faults = {worker: fault for worker, fault in self._faults.items() if worker in threads}
            if new:
                self._faults |= self._faults_of({worker: threads[worker] for worker in new})
        except (OSError, TimeoutError, CancelledError) as failure:
            raise self._scheduler_lost(failure) from failure
        self._last_poll_s = time.monotonic()
        if not all(self._faults.values()) or self._attempts:
            self._last_worker_s = self._last_poll_s
        elif self._last_poll_s - self._last_worker_s > NO_WORKER_LIMIT_S:
            raise GraspRefineError(
                f"{self._address}: the cluster has had no workers for {NO_WORKER_LIMIT_S:g} s; finished work is kept: "
                "start workers, and give the same command again"
            )

    def _faults_of(self, threads: Mapping[str, int]) -> dict[str, str]:
        """Fault of each worker, given its number of threads; empty if there is none."""
        probe = self._folder / f".probe-{uuid4().hex}"
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            probe.touch()
        except OSError as error:
            raise GraspRefineError(f"{self._folder}: cannot be written ({error.strerror or error})") from error
        try:
            here = inspect_environment(probe)
            for left in reversed(range(MAX_PROBES)):
                there = self._client.run(inspect_environment, probe, workers=list(threads), on_error="return")
                if all(isinstance(each, WorkerEnvironment) and each.reads for each in there.values()) or not left:
                    break
                time.sleep(1.0)
        finally:
            probe.unlink(missing_ok=True)
        faults = {worker: fault_of(there.get(worker), here, count, self._folder) for worker, count in threads.items()}
        return {worker: fault and f"worker {worker} {fault}" for worker, fault in faults.items()}

    def _scheduler_lost(self, failure: BaseException) -> GraspRefineError:
        return GraspRefineError(
            f"{self._address}: the Dask scheduler is lost ({message_of(failure)}); finished work is kept: start it and "
            "its workers, and give the same command again"
        )
