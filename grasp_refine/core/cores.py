"""The processor cores that this process may use."""

import os


def usable_cores() -> int:
    """How many: those that it may run on, where the system tells (macOS does not), else all of the machine."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
