"""Child processes for code that can crash, hang or fill the memory: bounded, and ended with this process."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from grasp_refine.core.interruption import end_with

POLL_INTERVAL_S = 0.1
"""Time between two calls of `check`, in seconds."""


@dataclass(frozen=True)
class Ended:
    """End of a child process."""

    code: int
    """Exit code; minus the number of the signal that ended it."""
    errors: str
    """Error output."""

    @property
    def out_of_time(self) -> bool:
        """Whether it used up its processor time."""
        return self.code == -signal.SIGXCPU

    @property
    def fault(self) -> str:
        """Exit code, and the last line of the error output."""
        return ": ".join([f"exit code {self.code}", *self.errors.strip().splitlines()[-1:]])


def run_module(
    module: str,
    *arguments: str,
    processor_s: float,
    memory_bytes: int | None = None,
    environment: Mapping[str, str] | None = None,
    check: Callable[[], None] = lambda: None,
) -> Ended:
    """Run a module as the main program of a child process, and wait for it.

    The module calls `limit_child` with its first argument; `arguments` follow. Processor time is bounded, no wall time:
    a busy machine changes no outcome. The child ends with this process, and with an exception from
    `check`, which is called every `POLL_INTERVAL_S`, or from a signal.

    Args:
        module: Full name of the module.
        arguments: Further arguments.
        processor_s: Maximum processor time of the child, all threads together, in seconds; infinite: no maximum.
        memory_bytes: Maximum address space of the child; None: no maximum.
        environment: Additional environment variables.
        check: Raises an exception where the result is not wanted any more.
    """
    limits = f"{os.getpid()},{processor_s},{memory_bytes or 0}"
    child = subprocess.Popen(
        [sys.executable, "-m", module, limits, *arguments],
        # The child imports from the same places as this process, also where the package is not installed.
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))} | dict(environment or {}),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
    )
    with child:
        try:
            return _wait(child, check)
        except BaseException:
            child.kill()
            raise


def _wait(child: subprocess.Popen[str], check: Callable[[], None]) -> Ended:
    while True:
        try:
            errors = child.communicate(timeout=POLL_INTERVAL_S)[1]
        except subprocess.TimeoutExpired:
            check()
        else:
            return Ended(child.returncode, errors)


def limit_child(limits: str) -> None:
    """Bound this process, a child of `run_module`, and make it end with its parent; `limits` is its first argument."""
    parent, processor_s, memory_bytes = limits.split(",")
    end_with(int(parent))
    if processor_s != "inf":
        seconds = max(1, round(float(processor_s)))
        # SIGXCPU can be caught by compiled code, SIGKILL a second later cannot.
        _lower(resource.RLIMIT_CPU, seconds, seconds + 1)
    if int(memory_bytes):
        _lower(resource.RLIMIT_AS, int(memory_bytes), int(memory_bytes))
    # A crash is expected, and of no use to a debugger.
    _lower(resource.RLIMIT_CORE, 0, 0)


def _lower(limit: int, soft: int, hard: int) -> None:
    """Lower a limit of this process; lower ones stay."""
    now = resource.getrlimit(limit)[1]
    if now != resource.RLIM_INFINITY:
        soft, hard = min(soft, now), min(hard, now)
    resource.setrlimit(limit, (soft, hard))
