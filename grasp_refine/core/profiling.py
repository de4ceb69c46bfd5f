"""CPU and wall seconds of a refinement by stage.

A stage is a `with stage("solver"):` or a decorator `@stage("solver")` at a boundary of the program. It counts for the
stopwatch that runs in its context (`with Stopwatch() as watch:`), and costs next to nothing where none runs. Stages may
be nested: a second counts for the innermost one only, so that all stages sum to the whole.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from contextvars import ContextVar, Token
from dataclasses import dataclass, field
from functools import wraps
from types import TracebackType
from typing import Any, Literal, ParamSpec, TypeVar, get_args

import numpy as np

Stage = Literal[
    "loading", "kinematics", "broad phase", "narrow phase", "derivative", "solver", "forces", "measuring",
    "simulating", "other",
]  # fmt: skip
"""Stage of the program.

- loading: files, convex pieces, and structures built once for a hand and an object.
- kinematics: poses and joint axes of links.
- broad phase: choice of the body pairs that are queried.
- narrow phase: coal, and the choice of pieces in its loop.
- derivative: residuals with their Jacobians, and gradients.
- solver: loss, steps and bookkeeping of the loop.
- forces: quadratic programs of contact forces.
- measuring: metrics of grasps before and after, without their queries.
- simulating: MuJoCo.
- other: everything else, such as writing files.
"""

STAGES: tuple[Stage, ...] = get_args(Stage)

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


CHILD_TIME_RESOLUTION_S = 0.01
"""Resolution (s) of the CPU time of child processes: within a shorter interval it is not read again."""


@dataclass
class StageTime:
    """Time and calls of a stage."""

    cpu_s: float = 0.0
    """CPU seconds, without nested stages."""
    wall_s: float = 0.0
    """Wall seconds, without nested stages."""
    calls: int = 0
    """Number of times that it began."""


@dataclass
class Stopwatch:
    """Seconds by stage while it runs; may run again, and then accumulates."""

    spent: dict[Stage, StageTime] = field(default_factory=lambda: {name: StageTime() for name in STAGES})
    """Time of each stage; "other" is the time outside all of them."""
    queries: int = 0
    """Narrow-phase queries."""
    patches: int = 0
    """Contacts whose patch of flat faces was looked for; none where nothing is flat."""
    scene_pairs: dict[str, int] = field(default_factory=dict)
    """Pairs of a link and a body of a scene, by the test that settled them: see `Surroundings.near`."""
    _open: list[Stage] = field(default_factory=list)
    _since: tuple[float, float] = (0.0, 0.0)
    _children: float = 0.0
    _token: Token[Stopwatch | None] | None = None

    def __enter__(self) -> Stopwatch:
        """Start to count in this context, in place of a stopwatch that already runs in it."""
        assert not self.running, "it runs already"
        self._token = _RUNNING.set(self)
        self._since, self._children = _now(), _children_cpu_seconds()
        self._open.append("other")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop, even in mid-stage."""
        assert self._token is not None, "it does not run"
        self._count(last=True)
        self._open.clear()
        _RUNNING.reset(self._token)
        self._token = None

    @property
    def running(self) -> bool:
        """Whether the stopwatch counts now."""
        return self._token is not None

    @property
    def profile(self) -> dict[str, list[float]]:
        """Stage -> [CPU seconds, wall seconds, calls], which other processes can add up."""
        return {name: [one.cpu_s, one.wall_s, one.calls] for name, one in self.spent.items()}

    @property
    def cpu_s(self) -> float:
        """CPU seconds of all stages."""
        return sum(one.cpu_s for one in self.spent.values())

    @property
    def wall_s(self) -> float:
        """Wall seconds of all stages."""
        return sum(one.wall_s for one in self.spent.values())

    def begin(self, name: Stage) -> None:
        """Begin a stage inside the present one."""
        self._count()
        self._open.append(name)
        self.spent[name].calls += 1

    def end(self) -> None:
        """End the stage that began last, unless the stopwatch stopped in the middle of it."""
        if len(self._open) > 1:
            self._count()
            self._open.pop()

    def _count(self, *, last: bool = False) -> None:
        """Add the time since the last call to the present stage."""
        now, spent = _now(), self.spent[self._open[-1]]
        wall = now[1] - self._since[1]
        spent.cpu_s += now[0] - self._since[0]
        spent.wall_s += wall
        self._since = now
        if last or wall > CHILD_TIME_RESOLUTION_S:
            children = _children_cpu_seconds()
            spent.cpu_s += children - self._children
            self._children = children


_RUNNING: ContextVar[Stopwatch | None] = ContextVar("stopwatch", default=None)


class stage:  # noqa: N801 - a context manager and a decorator
    """Counts the time inside a block or function for a stage of the running stopwatch, if any."""

    __slots__ = ("_name", "_watch")

    def __init__(self, name: Stage) -> None:
        """Name the stage, one of `STAGES`."""
        self._name = name

    def __enter__(self) -> None:
        """Begin the stage."""
        self._watch = _RUNNING.get()
        if self._watch is not None:
            self._watch.begin(self._name)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the stage, also after an error."""
        if self._watch is not None:
            self._watch.end()

    def __call__(self, function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        """Return the function, with its calls counted for the stage."""
        name = self._name

        @wraps(function)
        def counted(*arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
            watch = _RUNNING.get()
            if watch is None:
                return function(*arguments, **named)
            watch.begin(name)
            try:
                return function(*arguments, **named)
            finally:
                watch.end()

        return counted


def count_queries(num_queries: Any) -> None:
    """Add numbers of narrow-phase queries, of any shape, to the running stopwatch, if any."""
    watch = _RUNNING.get()
    if watch is not None:
        watch.queries += int(np.sum(num_queries))


def count_patches(number: int) -> None:
    """Add a number of contacts whose patch was looked for to the running stopwatch, if any."""
    watch = _RUNNING.get()
    if watch is not None:
        watch.patches += number


def count_scene_pairs(settled: Mapping[str, int]) -> None:
    """Add numbers of pairs of a link and a body of a scene to the running stopwatch, if any."""
    watch = _RUNNING.get()
    if watch is not None:
        for how, number in settled.items():
            watch.scene_pairs[how] = watch.scene_pairs.get(how, 0) + number


def cpu_seconds() -> float:
    """CPU seconds of this process so far: of all its threads, and of child processes that have ended."""
    return time.process_time() + _children_cpu_seconds()


def _now() -> tuple[float, float]:
    """CPU seconds of this process, and wall seconds, so far."""
    return time.process_time(), time.perf_counter()


def _children_cpu_seconds() -> float:
    """CPU seconds of child processes that have ended."""
    times = os.times()
    return times.children_user + times.children_system
