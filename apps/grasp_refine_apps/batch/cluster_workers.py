"""Workers of a Dask cluster: which there are, whether they are fit, their current shards, and which are lost."""

from __future__ import annotations

import pickle
import time
from collections.abc import Mapping
from concurrent.futures import CancelledError
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from uuid import uuid4

from distributed import Client, Future
from distributed.scheduler import KilledWorker

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.batch.attempt import message_of, traceback_of
from grasp_refine_apps.batch.dispatch import Event
from grasp_refine_apps.batch.on_cluster import (
    HEARTBEAT_INTERVAL_S,
    WorkerEnvironment,
    attempt_on_worker,
    inspect_environment,
)
from grasp_refine_apps.batch.schedule import Schedule
from grasp_refine_apps.batch.shard import Done, Failed, Reason, Shard, Sign, Work

POLL_INTERVAL_S = 1.0
"""Interval between two checks for new and lost workers, seconds."""

NO_WORKER_LIMIT_S = 60.0
"""Time without any fit worker after which a batch ends, seconds."""

FETCH_LIMIT_S = 20.0
"""Time limit for the arrival of a shard's result, and for the restart of a worker, seconds."""

MAX_PROBES = 4
"""Number of times, a second apart, that a worker looks for a new file: shared folders may show it late."""


@dataclass
class _Run:
    """A shard and the worker that works on it."""

    shard: Shard
    worker: str
    """Address of the worker."""
    future: Future
    heard_s: float
    """Time of the last heartbeat, on the clock of `ClusterWorkers`, seconds."""
    doing: Sign | None = None
    """Last heartbeat; None: there was none yet."""


class ClusterWorkers:
    """Workers of a cluster, for one batch."""

    def __init__(self, client: Client, address: str, work: Work, folder: Path, patience_s: float | None) -> None:
        """Check the workers; no shard is begun yet.

        Args:
            client: Connected client.
            address: Address of the scheduler, for messages.
            work: Work function for a shard.
            folder: Folder of the results.
            patience_s: Longest time without a heartbeat, seconds; None: no limit.

        Raises:
            GraspRefineError: There is no worker, or one that is not fit.
        """
        self._client, self._address, self._folder, self._patience_s = client, address, folder, patience_s
        self._work = pickle.dumps(work)
        self._runs: dict[int, _Run] = {}
        """Number of a shard -> its run."""
        self._groups: dict[str, str] = {}
        """Worker -> group of its last shard."""
        self._faults: dict[str, str] = {}
        """Worker -> reason why it is not fit; empty if it is."""
        self._inbox: SimpleQueue[tuple[int, Future | Sign]] = SimpleQueue()
        self._topic = f"grasp-refine-{uuid4().hex}"
        client.subscribe_topic(self._topic, self._put_sign)
        self._clock_s = 0.0
        """Time spent listening to workers, seconds: a pause of this process alone makes no worker look dead."""
        self._last_worker = self._last_poll = self._last_listened = time.monotonic()
        self._poll_workers()
        if not self._faults:
            raise GraspRefineError(
                f"{address}: the cluster has no workers; start some with "
                f"`dask worker {address} --nworkers 2 --nthreads 1`"
            )
        for fault in filter(None, self._faults.values()):
            raise GraspRefineError(fault)

    @property
    def busy(self) -> int:
        """Number of workers that have a shard."""
        return len(self._runs)

    def share_out(self, schedule: Schedule) -> None:
        """Give a shard to every fit and idle worker, as long as there are any."""
        busy = {run.worker for run in self._runs.values()}
        for worker in [worker for worker, fault in self._faults.items() if not fault and worker not in busy]:
            shard = schedule.take(self._groups.get(worker))
            if shard is None:
                return
            # For this worker alone: if it is lost, the shard returns to `dispatch`, which counts attempts.
            future = self._client.submit(
                attempt_on_worker,
                self._work,
                shard,
                self._topic,
                key=f"{shard.name}-{uuid4().hex}",
                workers=[worker],
                pure=False,
            )
            self._runs[shard.number] = _Run(shard, worker, future, self._clock_s)
            self._groups[worker] = shard.group
            future.add_done_callback(lambda future, number=shard.number: self._inbox.put((number, future)))

    def listen(self) -> list[Event]:
        """Return the events of shards, after a short wait if there are none; lost workers are forgotten.

        Raises:
            GraspRefineError: The scheduler, or all its workers, are lost.
        """
        events: list[Event] = []
        try:
            number, message = self._inbox.get(timeout=POLL_INTERVAL_S)
            while True:
                events += self._events_of(number, message)
                number, message = self._inbox.get_nowait()
        except Empty:
            pass
        now = time.monotonic()
        self._clock_s += min(now - self._last_listened, 2 * POLL_INTERVAL_S)
        self._last_listened = now
        if now - self._last_poll >= POLL_INTERVAL_S:
            self._poll_workers()
            events += self._losses()
        return events

    def _losses(self) -> list[Event]:
        """Return the failures of workers that are gone or hang; the latter are restarted."""
        events: list[Event] = []
        hanging: list[str] = []
        for run in list(self._runs.values()):
            if run.worker not in self._faults:
                events.append(self._lost(run, "crashed", "was lost"))
            elif self._hangs(run):
                events.append(self._lost(run, "hung", f"gave no sign of life for {self._patience_s:g} s"))
                hanging.append(run.worker)
        # Only now, because no message is received meanwhile.
        for worker in hanging:
            self._restart(worker)
        return events

    def _hangs(self, run: _Run) -> bool:
        """Return True if a begun shard makes no progress any more; one not begun yet may wait."""
        if self._patience_s is None or run.doing is None:
            return False
        # Later heartbeats may not be sent, or not be received yet.
        return self._clock_s - run.heard_s > self._patience_s + HEARTBEAT_INTERVAL_S + POLL_INTERVAL_S

    def _put_sign(self, event: tuple[float, tuple[int, str, float, int]]) -> None:
        """Receive a worker's event: its clock, and the number of the shard with the entries of a `Sign`."""
        _, (number, what, share, refined) = event
        self._inbox.put((number, (what, share, refined)))

    def _events_of(self, number: int, message: Future | Sign) -> list[Event]:
        """Events of a message; none if it is about an earlier attempt."""
        run = self._runs.get(number)
        if run is None:
            return []
        if isinstance(message, tuple):
            run.heard_s, run.doing = self._clock_s, message
            return [(run.shard, message)]
        if message.key != run.future.key:
            return []
        outcome = self._outcome(run)
        self._runs.pop(number, None)
        return [(run.shard, outcome)]

    def _outcome(self, run: _Run) -> Done | Failed:
        """Result of a shard that ended."""
        number = run.shard.number
        try:
            if run.future.status != "error":
                return run.future.result(timeout=FETCH_LIMIT_S)
            error = run.future.exception(timeout=FETCH_LIMIT_S)
        except TimeoutError:
            return Failed(number, "crashed", f"worker {run.worker} was lost with its result", "", tries=1)
        except (OSError, CancelledError) as failure:
            raise self._scheduler_lost(failure) from failure
        if isinstance(error, KilledWorker):
            return Failed(number, "crashed", f"workers were lost: {message_of(error)}", "", tries=1)
        return Failed(number, "error", message_of(error), traceback_of(error), tries=1)

    def _lost(self, run: _Run, reason: Reason, how: str) -> Event:
        """End a run that has no outcome."""
        del self._runs[run.shard.number]
        run.future.release()
        last = "" if run.doing is None else f" at {run.doing[1]:.0%} of the shard: {run.doing[0]}"
        return run.shard, Failed(run.shard.number, reason, f"worker {run.worker} {how}{last}", "", tries=1)

    def _restart(self, worker: str) -> None:
        """Restart a worker that hangs; one that cannot be restarted gets no more shards."""
        try:
            self._client.restart_workers([worker], timeout=FETCH_LIMIT_S, raise_for_error=False)
            # From now on a worker of this address is a new one.
            self._faults.pop(worker, None)
        except ValueError:
            self._faults[worker] = f"worker {worker} hangs, and has no nanny to restart it"

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
        self._groups = {worker: group for worker, group in self._groups.items() if worker in threads}
        self._last_poll = time.monotonic()
        if not all(self._faults.values()) or self._runs:
            self._last_worker = self._last_poll
        elif self._last_poll - self._last_worker > NO_WORKER_LIMIT_S:
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


def fault_of(there: object, here: WorkerEnvironment, threads: int, folder: Path) -> str:
    """Fault of a worker; empty if there is none.

    Args:
        there: Environment of the worker, or the error of its check.
        here: Environment of this process.
        threads: Number of threads of the worker.
        folder: Folder of the results.
    """
    if not isinstance(there, WorkerEnvironment):
        reason = message_of(there) if isinstance(there, BaseException) else "no answer"
        return f"cannot run grasp-refine ({reason}): install there the same packages as here"
    if there.versions != here.versions:
        ours, theirs = (", ".join(" ".join(pair) for pair in each.versions) for each in (here, there))
        return f"has {theirs}, but here are {ours}: install the same in both places"
    if not (there.reads and there.writes):
        verb = "write into" if there.reads else "see"
        return f"cannot {verb} {folder}: results need a folder that all machines share, under the same name"
    if threads != 1:
        return f"has {threads} threads, but works on one shard at a time: start workers with --nthreads 1"
    return ""
