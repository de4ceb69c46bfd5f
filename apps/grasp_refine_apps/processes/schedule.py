"""Order of the tasks: an idle worker first gets tasks of the group that it has loaded."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable
from typing import Generic, TypeVar

from grasp_refine_apps.processes.task import Task

AnyTask = TypeVar("AnyTask", bound=Task)


class Schedule(Generic[AnyTask]):
    """Tasks waiting for a worker, by group, and the choice of the next one.

    The first task of a group runs alone, because it may fill a cache for all others; they wait for it as long as there
    are other tasks.
    """

    def __init__(self, tasks: Iterable[AnyTask]) -> None:
        """Queue all tasks; groups are opened in the order in which they occur."""
        self._waiting: defaultdict[str, deque[AnyTask]] = defaultdict(deque)
        for task in tasks:
            self._waiting[task.group].append(task)
        self._untouched = deque(self._waiting)
        self._touched: set[str] = set()
        """Opened groups with tasks left: about as many as there are workers."""
        self._first: dict[str, int] = {}
        """Group -> number of its first task, while that one runs."""
        self._left = sum(map(len, self._waiting.values()))

    def __len__(self) -> int:
        """Return the number of waiting tasks."""
        return self._left

    def take(self, loaded: str | None) -> AnyTask | None:
        """Take the next task for a worker that has loaded the group `loaded`; None: none is left."""
        if loaded in self._touched and loaded not in self._first:
            return self._pop(loaded)
        if self._untouched:
            group = self._untouched.popleft()
            self._touched.add(group)
            task = self._pop(group)
            self._first[group] = task.number
            return task
        if not self._touched:
            return None
        # The group with most tasks left; one whose first task still runs only if there is no other.
        return self._pop(max(sorted(self._touched), key=lambda each: (each not in self._first, self._count(each))))

    def finish(self, task: AnyTask) -> None:
        """Mark a task as complete or failed: the others of its group need not wait for it."""
        self._first.pop(task.group, None)

    def requeue(self, task: AnyTask) -> None:
        """Queue a task for another attempt, after the others of its group."""
        opened = self._first.get(task.group) == task.number
        if opened:
            del self._first[task.group]
        self._waiting[task.group].append(task)
        self._left += 1
        if opened:
            self._touched.discard(task.group)
            self._untouched.append(task.group)
        elif task.group not in self._untouched:
            self._touched.add(task.group)

    def _count(self, group: str) -> int:
        return len(self._waiting[group])

    def _pop(self, group: str) -> AnyTask:
        task = self._waiting[group].popleft()
        self._left -= 1
        if not self._waiting[group]:
            del self._waiting[group]
            self._touched.discard(group)
        return task
