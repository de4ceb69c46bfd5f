"""Dispatch of tasks to any kind of workers: tasks go out, results come back, tasks of lost workers go out again."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from grasp_refine_apps.processes.schedule import Schedule
from grasp_refine_apps.processes.task import LOST, Failed, Reason, Sign, Task

MAX_CLOCK_STEP_S = 2.0
"""Longest time between two looks at the workers that counts, seconds: a pause of this process makes none look dead."""

SLACK_S = 2.0
"""Time added to the patience, seconds: later heartbeats may not be sent, or not be received yet."""

AnyTask = TypeVar("AnyTask", bound=Task)

OnHeartbeat = Callable[[int, str, float, int], None]
"""Receiver of heartbeats: the number of the task, and the entries of a `Sign`."""


@dataclass(frozen=True)
class Lost:
    """End of a worker."""

    cause: str
    """Words that follow the worker's name, such as "was lost"."""
    log: str = ""
    """End of what the worker wrote."""


@runtime_checkable
class Pool(Protocol):
    """Workers, each a process with one task at a time; to be closed after the run, however it ends."""

    @property
    def has_queues(self) -> bool:
        """Whether a task may have to wait at its worker, without heartbeats, for tasks of others."""
        ...

    def workers(self, wanted: int) -> Sequence[str]:
        """Return the workers that are ready; up to `wanted` are started where there are fewer.

        Raises:
            GraspRefineError: There is none, and none can be started.
        """
        ...

    def submit(self, worker: str, task: Any) -> None:
        """Give a task to a worker that has none."""
        ...

    def listen(self) -> list[tuple[str, Any]]:
        """Return the messages of workers, after a short wait if there are none: a Sign, the result, or a Lost."""
        ...

    def restart(self, worker: str) -> str:
        """End a worker that hangs, and return the end of its log."""
        ...


@dataclass
class _Run(Generic[AnyTask]):
    """A task that a worker has."""

    task: AnyTask
    heard_s: float
    """Time of the last heartbeat, on the clock of `dispatch`, seconds."""
    sign: Sign | None = None
    """Last heartbeat; None: there was none yet."""


def dispatch(
    tasks: Iterable[AnyTask], pool: Pool, *, tries: int, patience_s: float | None, heartbeat: OnHeartbeat
) -> Generator[tuple[AnyTask, Any], None, None]:
    """Dispatch tasks to workers; yield each with its result or `Failed`, in the order in which they end.

    Args:
        tasks: The tasks.
        pool: The workers.
        tries: Maximum attempts at a task whose worker crashes or hangs; one whose work raises is tried once.
        patience_s: Time without a heartbeat, seconds, after which a worker counts as hanging; only time in which this
            process listens counts. None: no limit.
        heartbeat: Called with the heartbeats.
    """
    schedule = Schedule(tasks)
    running: dict[str, _Run[AnyTask]] = {}
    groups: dict[str, str] = {}
    attempts: Counter[int] = Counter()
    ended: list[tuple[AnyTask, Any]] = []
    clock_s, last_s = 0.0, time.monotonic()

    def end(worker: str, outcome: Any) -> None:
        """Take the outcome of an attempt; the task is queued again, or has ended."""
        task = running.pop(worker).task
        attempts[task.number] += 1
        if isinstance(outcome, Failed):
            if outcome.reason in LOST and attempts[task.number] < tries:
                schedule.requeue(task)
                return
            outcome = replace(outcome, tries=attempts[task.number])
        schedule.finish(task)
        ended.append((task, outcome))

    def lose(worker: str, reason: Reason, lost: Lost) -> None:
        """Take the loss of a worker and of its attempt."""
        groups.pop(worker, None)
        if worker in running:
            sign = running[worker].sign
            last = "" if sign is None else f" at {sign.share:.0%} of the task: {sign.what}"
            end(worker, Failed(reason, f"worker {worker} {lost.cause}{last}", lost.log))

    while True:
        idle = [worker for worker in pool.workers(len(running) + len(schedule)) if worker not in running]
        for worker in idle[: len(schedule)]:
            task = schedule.take(groups.get(worker))
            assert task is not None
            pool.submit(worker, task)
            running[worker], groups[worker] = _Run(task, clock_s), task.group
        # Only now, so that workers have tasks while the caller handles the results.
        yield from ended
        ended.clear()
        if not running and not len(schedule):
            return
        messages = pool.listen()
        now_s = time.monotonic()
        clock_s, last_s = clock_s + min(now_s - last_s, MAX_CLOCK_STEP_S), now_s
        for worker, message in messages:
            if isinstance(message, Lost):
                lose(worker, "crashed", message)
            elif isinstance(message, Sign):
                run = running[worker]
                run.heard_s, run.sign = clock_s, message
                heartbeat(run.task.number, *message)
            else:
                end(worker, message)
        for worker, run in list(running.items()):
            begun = run.sign is not None or not pool.has_queues
            if patience_s is not None and begun and clock_s - run.heard_s > patience_s + SLACK_S:
                lose(worker, "hung", Lost(f"gave no sign of life for {patience_s:g} s", pool.restart(worker)))
