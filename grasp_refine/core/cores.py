"""Processor cores that this process may use."""

import os


def usable_cores() -> int:
    """Number of cores in the process's affinity mask; of the whole machine where there is none, as on macOS."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_count(threads: int | None) -> int:
    """Number of threads that is asked for; None: as many as `usable_cores`."""
    return usable_cores() if threads is None else threads
