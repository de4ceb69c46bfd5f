"""The workers of a Dask cluster: who they are, whether they are fit, what they work on, and which of them are lost."""

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
from grasp_refine_apps.batch.on_cluster import BEAT_S, Seen, attempt_there, seen
from grasp_refine_apps.batch.schedule import Schedule
from grasp_refine_apps.batch.shard import Done, Failed, Reason, Shard, Sign, Work

LOOK_S = 1.0
"""Who has come and who has gone is looked at this often."""

ALONE_S = 60.0
"""Without any fit worker for so long, a batch ends."""

FETCH_S = 20.0
"""How long what came of a shard may take to arrive, and a worker to start again."""

PROBES = 4
"""How often a worker is asked for a file just written, a second apart: shared folders may show it late."""


@dataclass
class _Run:
    """A shard that a worker has."""

    shard: Shard
    worker: str
    """Its address."""
    future: Future
    heard_s: float
    """When there was last a sign of life."""
    doing: Sign | None = None
    """What it said."""


class ClusterWorkers:
    """The workers of a cluster, for one batch."""

    def __init__(self, client: Client, address: str, work: Work, folder: Path, patience_s: float | None) -> None:
        """Nothing is begun yet.

        Args:
            client: Connected.
            address: Of the scheduler, for messages.
            work: What workers do with a shard.
            folder: Where results go.
            patience_s: How long workers may give no sign of life (s); None: for ever.

        Raises:
            GraspRefineError: There is no worker, or one that is not fit.
        """
        self._client, self._address, self._folder, self._patience_s = client, address, folder, patience_s
        self._work = pickle.dumps(work)
        self._runs: dict[int, _Run] = {}
        """Number of a shard -> who has it."""
        self._groups: dict[str, str] = {}
        """Worker -> the group of its last shard."""
        self._faults: dict[str, str] = {}
        """Worker -> why it is not fit; empty if it is."""
        self._inbox: SimpleQueue[tuple[int, Future | Sign]] = SimpleQueue()
        self._topic = f"grasp-refine-{uuid4().hex}"
        client.subscribe_topic(self._topic, self._put_sign)
        self._clock_s = 0.0
        """How long workers were listened to, so that a pause of this process alone makes nobody look dead."""
        self._accompanied = self._looked = self._listened = time.monotonic()
        self._look()
        if not self._faults:
            raise GraspRefineError(
                f"{address}: the cluster has no workers; start some with "
                f"`dask worker {address} --nworkers 2 --nthreads 1`"
            )
        for fault in filter(None, self._faults.values()):
            raise GraspRefineError(fault)

    @property
    def busy(self) -> int:
        """How many workers have a shard."""
        return len(self._runs)

    def share_out(self, schedule: Schedule) -> None:
        """Give every fit worker that has nothing to do a shard, as long as there are any."""
        busy = {run.worker for run in self._runs.values()}
        for worker in [worker for worker, fault in self._faults.items() if not fault and worker not in busy]:
            shard = schedule.take(self._groups.get(worker))
            if shard is None:
                return
            # For this worker alone: if it is lost, the shard comes back to where tries are counted.
            future = self._client.submit(
                attempt_there,
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
        """What was heard about shards, after a short wait if need be; lost workers are forgotten.

        Raises:
            GraspRefineError: The scheduler, or all its workers, are lost.
        """
        news: list[Event] = []
        try:
            number, said = self._inbox.get(timeout=LOOK_S)
            while True:
                news += self._understood(number, said)
                number, said = self._inbox.get_nowait()
        except Empty:
            pass
        now = time.monotonic()
        self._clock_s += min(now - self._listened, 2 * LOOK_S)
        self._listened = now
        if now - self._looked >= LOOK_S:
            self._look()
            news += self._losses()
        return news

    def _losses(self) -> list[Event]:
        """What was lost with workers that are gone or hang; the latter are restarted."""
        news: list[Event] = []
        hanging: list[str] = []
        for run in list(self._runs.values()):
            if run.worker not in self._faults:
                news.append(self._lost(run, "crashed", "was lost"))
            elif self._hangs(run):
                news.append(self._lost(run, "hung", f"gave no sign of life for {self._patience_s:g} s"))
                hanging.append(run.worker)
        # Only now, because nobody listens meanwhile.
        for worker in hanging:
            self._restart(worker)
        return news

    def _hangs(self, run: _Run) -> bool:
        """Whether a shard that was begun is not worked on any more; one that waits for something else may wait."""
        if self._patience_s is None or run.doing is None:
            return False
        # What was said may be followed by some that was not sent, or not listened to yet.
        return self._clock_s - run.heard_s > self._patience_s + BEAT_S + LOOK_S

    def _put_sign(self, event: tuple[float, tuple[int, str, float, int]]) -> None:
        """Take in what a worker said: its clock, and the number of the shard with what a `Sign` holds."""
        _, (number, what, share, refined) = event
        self._inbox.put((number, (what, share, refined)))

    def _understood(self, number: int, said: Future | Sign) -> list[Event]:
        """What a message means; nothing if it is about an earlier try."""
        run = self._runs.get(number)
        if run is None:
            return []
        if isinstance(said, tuple):
            run.heard_s, run.doing = self._clock_s, said
            return [(run.shard, said)]
        if said.key != run.future.key:
            return []
        outcome = self._outcome(run)
        self._runs.pop(number, None)
        return [(run.shard, outcome)]

    def _outcome(self, run: _Run) -> Done | Failed:
        """What came of a shard that ended."""
        number = run.shard.number
        try:
            if run.future.status != "error":
                return run.future.result(timeout=FETCH_S)
            error = run.future.exception(timeout=FETCH_S)
        except TimeoutError:
            return Failed(number, "crashed", f"worker {run.worker} was lost with what it had done", "", tries=1)
        except (OSError, CancelledError) as failure:
            raise self._cut_off(failure) from failure
        if isinstance(error, KilledWorker):
            return Failed(number, "crashed", f"workers were lost: {message_of(error)}", "", tries=1)
        return Failed(number, "error", message_of(error), traceback_of(error), tries=1)

    def _lost(self, run: _Run, reason: Reason, how: str) -> Event:
        """The end of a run without an outcome."""
        del self._runs[run.shard.number]
        run.future.release()
        last = "" if run.doing is None else f" at {run.doing[1]:.0%} of the shard: {run.doing[0]}"
        return run.shard, Failed(run.shard.number, reason, f"worker {run.worker} {how}{last}", "", tries=1)

    def _restart(self, worker: str) -> None:
        """Let a worker that hangs begin anew; one whom nobody can restart gets nothing to do any more."""
        try:
            self._client.restart_workers([worker], timeout=FETCH_S, raise_for_error=False)
            # Whoever has this address from now on is somebody new.
            self._faults.pop(worker, None)
        except ValueError:
            self._faults[worker] = f"worker {worker} hangs, and has no nanny to restart it"

    def _look(self) -> None:
        """See who is there, and whether those that are new are fit."""
        try:
            threads: Mapping[str, int] = self._client.nthreads()
            new = [worker for worker in threads if worker not in self._faults]
            self._faults = {worker: fault for worker, fault in self._faults.items() if worker in threads}
            if new:
                self._faults |= self._examined({worker: threads[worker] for worker in new})
        except (OSError, TimeoutError, CancelledError) as failure:
            raise self._cut_off(failure) from failure
        self._groups = {worker: group for worker, group in self._groups.items() if worker in threads}
        self._looked = time.monotonic()
        if not all(self._faults.values()) or self._runs:
            self._accompanied = self._looked
        elif self._looked - self._accompanied > ALONE_S:
            raise GraspRefineError(
                f"{self._address}: the cluster has had no workers for {ALONE_S:g} s; what is done is kept: "
                "start workers, and give the same command again"
            )

    def _examined(self, threads: Mapping[str, int]) -> dict[str, str]:
        """What is wrong with each worker, given its number of threads; empty if nothing is."""
        probe = self._folder / f".probe-{uuid4().hex}"
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            probe.touch()
        except OSError as error:
            raise GraspRefineError(f"{self._folder}: cannot be written ({error.strerror or error})") from error
        try:
            here = seen(probe)
            for left in reversed(range(PROBES)):
                there = self._client.run(seen, probe, workers=list(threads), on_error="return")
                if all(isinstance(each, Seen) and each.reads for each in there.values()) or not left:
                    break
                time.sleep(1.0)
        finally:
            probe.unlink(missing_ok=True)
        faults = {worker: fault_of(there.get(worker), here, count, self._folder) for worker, count in threads.items()}
        return {worker: fault and f"worker {worker} {fault}" for worker, fault in faults.items()}

    def _cut_off(self, failure: BaseException) -> GraspRefineError:
        return GraspRefineError(
            f"{self._address}: the Dask scheduler is lost ({message_of(failure)}); what is done is kept: start it and "
            "its workers, and give the same command again"
        )


def fault_of(there: object, here: Seen, threads: int, folder: Path) -> str:
    """What is wrong with a worker; empty if nothing is.

    Args:
        there: What it sees, or why it could not look.
        here: What this process sees.
        threads: How many threads it has.
        folder: Where results go.
    """
    if not isinstance(there, Seen):
        said = message_of(there) if isinstance(there, BaseException) else "no answer"
        return f"cannot run grasp-refine ({said}): install there what is installed here"
    if there.versions != here.versions:
        ours, theirs = (", ".join(" ".join(pair) for pair in each.versions) for each in (here, there))
        return f"has {theirs}, but here are {ours}: install the same in both places"
    if not (there.reads and there.writes):
        verb = "write into" if there.reads else "see"
        return f"cannot {verb} {folder}: results need a folder that all machines share, under the same name"
    if threads != 1:
        return f"has {threads} threads, but works on one shard at a time: start workers with --nthreads 1"
    return ""
