"""Works that tests give to workers of a batch: they can be imported by the workers, too."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

from grasp_refine.core.errors import MeshError
from grasp_refine_apps.batch.shard import Done, Heartbeat, Shard
from grasp_refine_apps.batch.worker_pool import ONE_THREAD


def some_shards(folder: Path, *tasks: str, group: str = "g") -> list[Shard]:
    """One shard per task of `work`, numbered from 0; "group:task" names its group."""
    shards = []
    for number, task in enumerate(tasks):
        of, _, what = task.rpartition(":")
        shards.append(Shard(number, of or group, f"shard {number}", 1, folder / f"{number}.txt", "0", what))
    return shards


def done(shard: Shard) -> Done:
    """What is told of a shard that came out."""
    return Done(shard.number, shard.size, shard.size, (0, 1), None, 0.0, 0.0, 0)


def work(shard: Shard, beat: Heartbeat) -> Done:
    """Do what the task says, and write which process did."""
    first = not (started := shard.path.with_suffix(".started")).exists()
    started.touch()
    beat(shard.task, 0.25)
    verb, _, how = shard.task.partition(" ")
    ACTIONS[verb](how, first, beat)
    shard.path.write_text(str(os.getpid()))
    return done(shard)


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


def _worse(how: str, first: bool, beat: Heartbeat) -> None:
    """Crashes first, then raises."""
    (_crash if first else _raise)("exit" if first else "value", first, beat)


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

    def __call__(self, shard: Shard, beat: Heartbeat) -> Done:
        self.calls += 1
        shard.path.write_text(f"{os.getpid()} {self.calls}")
        return done(shard)


def tallies(folder: Path) -> list[list[int]]:
    """For each process, the calls that it counted, in order."""
    by_process: dict[str, list[int]] = {}
    for path in folder.glob("*.txt"):
        process, calls = path.read_text().split()
        by_process.setdefault(process, []).append(int(calls))
    return [sorted(calls) for calls in by_process.values()]


class Unloadable:
    """A task that no worker can load."""

    def __reduce__(self):
        return import_module, ("no_such_module",)


class Unknown:
    """A work that no worker can load."""

    def __reduce__(self):
        return import_module, ("no_such_module",)

    def __call__(self, shard: Shard, beat: Heartbeat) -> Done:
        raise NotImplementedError


class Slow(Unknown):
    """A work that takes too long to load."""

    def __reduce__(self):
        return time.sleep, (3600.0,)


ACTIONS = {
    "write": lambda how, first, beat: None,
    "raise": _raise,
    "crash": _crash,
    "worse": _worse,
    "sleep": _sleep,
    "beat": _beat,
    "child": _child,
    "compute": _compute,
    "tidy": _tidy,
    "threads": _threads,
    "print": _print,
}
