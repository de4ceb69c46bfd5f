"""Work functions and tasks that tests give to workers, which can import them, too."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from grasp_refine.core.errors import MeshError
from grasp_refine_apps.bench.jobs import Job
from grasp_refine_apps.processes.local import ONE_THREAD
from grasp_refine_apps.processes.task import Heartbeat


@dataclass(frozen=True)
class FakeTask:
    """A task of `work`."""

    number: int
    group: str
    path: Path
    """A file that the work writes."""
    verb: Any


def some_tasks(folder: Path, *verbs: Any, group: str = "g") -> list[FakeTask]:
    """One task for each call of ACTIONS, numbered from 0; "group:verb" names its group."""
    tasks = []
    for number, verb in enumerate(verbs):
        of, _, what = verb.rpartition(":") if isinstance(verb, str) else ("", "", verb)
        tasks.append(FakeTask(number, of or group, folder / f"{number}.txt", what))
    return tasks


def work(task: FakeTask, beat: Heartbeat) -> str:
    """Do what the task says, write which process did, and return the name of the file."""
    first = not (started := task.path.with_suffix(".started")).exists()
    started.touch()
    beat(task.verb, 0.25)
    verb, _, how = task.verb.partition(" ")
    ACTIONS[verb](how, first, beat)
    task.path.write_text(str(os.getpid()))
    return task.path.name


class StubbornError(Exception):
    """Cannot be pickled, and fails when asked what it says."""

    def __reduce__(self):
        raise TypeError("not me")

    def __str__(self):
        raise ValueError("not this, either")


def _raise(how: str, first: bool, beat: Heartbeat) -> None:
    raise {
        "mesh": MeshError("mug.obj: no such mesh;\ntry another"),
        "value": ValueError("no luck"),
        "stubborn": StubbornError(),
        "memory": MemoryError(),
        "full": OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "out.npz"),
        "long": ValueError("x" * 10_000),
    }[how]


def _crash(how: str, first: bool, beat: Heartbeat) -> None:
    if how.startswith("once") and not first:
        return
    print("about to crash", file=sys.stderr, flush=True)
    if how.endswith("exit"):
        os._exit(3)
    os.kill(os.getpid(), signal.Signals[how.split()[-1]])
    time.sleep(3600.0)


def _sleep(how: str, first: bool, beat: Heartbeat) -> None:
    time.sleep(float(how))


def _beat(how: str, first: bool, beat: Heartbeat) -> None:
    until = time.monotonic() + float(how)
    while time.monotonic() < until:
        beat("still there", 0.5, 3)
        time.sleep(0.01)


def _child(how: str, first: bool, beat: Heartbeat) -> None:
    """A process of its own, whose number is written down."""
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(3600)"])
    Path(how).write_text(str(child.pid))
    time.sleep(3600.0)


def _compute(how: str, first: bool, beat: Heartbeat) -> None:
    """Compiled code that never ends, and lets no other thread of Python run."""
    Path(how).write_text(str(os.getpid()))
    re.match("(a+)+$", "a" * 60 + "b")


def _tidy(how: str, first: bool, beat: Heartbeat) -> None:
    """Takes away what is half written."""
    partial = Path(how)
    partial.touch()
    try:
        time.sleep(3600.0)
    finally:
        partial.unlink()


def _threads(how: str, first: bool, beat: Heartbeat) -> None:
    Path(how).write_text(" ".join(f"{name}={os.environ.get(name)}" for name in ONE_THREAD))


def _print(how: str, first: bool, beat: Heartbeat) -> None:
    os.write(1, b"out\n")
    print("error", file=sys.stderr)


class Tally:
    """A work that remembers how often this process has called it."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, task: FakeTask, beat: Heartbeat) -> tuple[int, int]:
        self.calls += 1
        return os.getpid(), self.calls


class Unknown:
    """A work, or a part of a task, that no worker can load."""

    def __reduce__(self):
        return import_module, ("no_such_module",)

    def __call__(self, task: FakeTask, beat: Heartbeat) -> None:
        raise NotImplementedError


class Slow(Unknown):
    """A work that takes too long to load."""

    def __reduce__(self):
        return time.sleep, (3600.0,)


def fake_job(label: str, work: float = 1.0) -> Job:
    """A job of a benchmark that gives its name, or fails."""
    return Job(label, partial(_job, label), work)


def _job(label: str, progress: Callable[[float], None]) -> str:
    progress(0.5)
    if label == "stop":
        raise KeyboardInterrupt
    if label == "bad":
        raise ValueError("no luck")
    if label == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    return label


ACTIONS = {
    "write": lambda how, first, beat: None,
    "raise": _raise,
    "crash": _crash,
    "sleep": _sleep,
    "beat": _beat,
    "child": _child,
    "compute": _compute,
    "tidy": _tidy,
    "threads": _threads,
    "print": _print,
}
