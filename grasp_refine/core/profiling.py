"""CPU and wall seconds by stage: where the time of a refinement goes.

A stage is a `with stage("solver"):` or a decorator `@stage("solver")` at a boundary of the program. It counts for the
stopwatch that runs in its context (`with Stopwatch() as watch:`), and does next to nothing where none does. Stages may
lie inside each other: a second counts for the innermost one only, so that all stages sum to the whole.

Another thread has a context, and so a stopwatch, of its own. CPU time is that of the process: of all its threads, and
of its child processes once they ended.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
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
"""What the program is at.

- loading: files, convex pieces, and what is built once for a hand and an object.
- kinematics: poses and joint axes of links.
- broad phase: which pieces can matter, and what goes into the narrow phase and comes out of it.
- narrow phase: coal; of the compiled engine, with the choice of pieces in its loop.
- derivative: residuals with their Jacobians, and gradients.
- solver: loss, steps and accounts of the loop.
- forces: quadratic programs of contact forces.
- measuring: what is reported of grasps before and after, but for its queries.
- simulating: MuJoCo.
- other: everything else, such as writing files.
"""

STAGES: tuple[Stage, ...] = get_args(Stage)

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


TICK = 0.01
"""No child process ended within so many seconds that needs to be looked for: that is how finely their time is told."""


@dataclass
class Spent:
    """What a stage took."""

    cpu_s: float = 0.0
    """CPU seconds, without those of stages inside it."""
    wall_s: float = 0.0
    """Seconds of the clock likewise."""
    calls: int = 0
    """How often it began."""


@dataclass
class Stopwatch:
    """Seconds by stage while it runs; may run again, and then counts on."""

    spent: dict[Stage, Spent] = field(default_factory=lambda: {name: Spent() for name in STAGES})
    """What each stage took; "other" is what passed outside all of them."""
    queries: int = 0
    """Narrow-phase queries."""
    _open: list[Stage] = field(default_factory=list)
    _since: tuple[float, float] = (0.0, 0.0)
    _children: float = 0.0
    _token: Token[Stopwatch | None] | None = None

    def __enter__(self) -> Stopwatch:
        """Begin to count what happens in this context, instead of another one that runs in it already."""
        assert not self.running, "it runs already"
        self._token = _RUNNING.set(self)
        self._since, self._children = _now(), _of_children()
        self._open.append("other")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop, also in mid-stage."""
        assert self._token is not None, "it does not run"
        self._count(last=True)
        self._open.clear()
        _RUNNING.reset(self._token)
        self._token = None

    @property
    def running(self) -> bool:
        """Whether it counts now."""
        return self._token is not None

    @property
    def profile(self) -> dict[str, list[float]]:
        """Stage -> [CPU seconds, wall seconds, calls]: what other processes can add up."""
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
        """A stage begins inside the present one."""
        self._count()
        self._open.append(name)
        self.spent[name].calls += 1

    def end(self) -> None:
        """The stage ends that began last, unless the stopwatch stopped in the middle of it."""
        if len(self._open) > 1:
            self._count()
            self._open.pop()

    def _count(self, *, last: bool = False) -> None:
        """What passed since the last time counts for the present stage."""
        now, spent = _now(), self.spent[self._open[-1]]
        wall = now[1] - self._since[1]
        spent.cpu_s += now[0] - self._since[0]
        spent.wall_s += wall
        self._since = now
        if last or wall > TICK:
            children = _of_children()
            spent.cpu_s += children - self._children
            self._children = children


_RUNNING: ContextVar[Stopwatch | None] = ContextVar("stopwatch", default=None)


class stage:  # noqa: N801 - reads as what it is, a context manager and a decorator
    """Counts what happens inside, or in a function, for a stage of the stopwatch that runs, if any does."""

    __slots__ = ("_name", "_watch")

    def __init__(self, name: Stage) -> None:
        """The stage's name, one of `STAGES`."""
        self._name = name

    def __enter__(self) -> None:
        """Begin."""
        self._watch = _RUNNING.get()
        if self._watch is not None:
            self._watch.begin(self._name)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End, also by an error."""
        if self._watch is not None:
            self._watch.end()

    def __call__(self, function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        """The function, whose calls count for the stage."""
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


def count_queries(asked: Any) -> None:
    """Add narrow-phase queries, numbers of any shape, to the stopwatch that runs, if any does."""
    watch = _RUNNING.get()
    if watch is not None:
        watch.queries += int(np.sum(asked))


def cpu_seconds() -> float:
    """CPU time of this process so far: of all its threads, and of the child processes that have ended."""
    return time.process_time() + _of_children()


def _now() -> tuple[float, float]:
    """CPU seconds of this process, and wall seconds, so far."""
    return time.process_time(), time.perf_counter()


def _of_children() -> float:
    """CPU seconds of the child processes that ended."""
    times = os.times()
    return times.children_user + times.children_system
